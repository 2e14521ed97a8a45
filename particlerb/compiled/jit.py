"""The only caller of Numba's compiler: two decorators and the place of the disk cache.

`inline` is for helpers of scalars and tuples, which have no code of their own (see `helper`),
`kernel` for loops over bodies, `unfused_kernel` for those that Python may run too (see `plain`).
Kernels run without the interpreter's lock, so that `threads` can spread them. One that only others
call is compiled as they are, once, with no entry for Python. Both are kept on disk.
`splice` is for a function that does no more than call others: it is copied
into its callers, and not compiled by itself.
Numba's cache does not notice an edit in another file, nor a changed NUMBA_* flag; so the cache
folder has a hash of all of it in its name. Nor does it notice that a file was cut or changed, or
give up where none can be written: each file has a hash of its content, what is damaged is compiled
anew, and one warning says what is not kept.
"""

import contextlib
import functools
import hashlib
import linecache
import logging
import os
import pickle
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, TypeAlias, TypeVar, cast

import numba
import numpy as np
from llvmlite import binding
from numba.core import caching
from numba.core.event import install_timer
from numba.core.runtime._nrt_python import c_helpers

from particlerb.compiled.deferred import Dispatcher
from particlerb.compiled.helper import AloneCompiler, Helper, KeptCode, KeptKernel, Kernel
from particlerb.compiled.plain import InPlaceOf, UnfusedKernel, in_python

config: Any = numba.config
Function = TypeVar("Function", bound=Callable[..., Any])
Flag: TypeAlias = int | None  # 1, or None: types of their own, so that Numba leaves code out

_PACKAGE = Path(__file__).parents[1]
FOLDERS_KEPT = 6  # compiled code of earlier sources: switching between two versions stays warm
_FLAGS: dict[str, Any] = {
    "error_model": "numpy",  # 1 / 0 is inf: a branch for ZeroDivisionError would stop vectorising
    "fastmath": {"contract"},  # a b + c in one rounding; nothing that changes what NaN means
}


_LOG: Final = logging.getLogger(__name__)
WHEN_COMPILING: Final = ["kernels, once: 5 to 20 s, with contact a minute or more"]  # said once


class CacheWarning(RuntimeWarning):
    """Compiled code cannot be kept: the next start compiles again."""


@functools.cache
def source_hash() -> str:
    """Hash of everything that decides what the compiler makes: sources, flags, versions."""
    digest = hashlib.sha256()
    for path in sorted([*_PACKAGE.rglob("*.py"), *_PACKAGE.rglob("*.txt")]):
        digest.update(path.relative_to(_PACKAGE).as_posix().encode())
        digest.update(path.read_bytes())
    names = {k for k in os.environ if k.startswith("NUMBA_")}
    flags = {k: os.environ[k] for k in names - {"NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS"}}
    digest.update(repr((sorted(flags.items()), numba.__version__, sys.version)).encode())
    return digest.hexdigest()[:16]


def cache_root() -> Path:
    """Folder of the user's caches that can be written; a private temporary one otherwise."""
    try:
        root = _user_caches() / "particlerb"
        root.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=root):
            return root
    except (OSError, RuntimeError):  # RuntimeError: nobody knows where home is
        return _private_temporary_root()


def _user_caches() -> Path:
    """Folder for caches that the user, or the system, has chosen."""
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(chosen)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _private_temporary_root() -> Path:
    """Temporary folder that belongs to this user alone: compiled code is loaded from it."""
    user = os.getuid() if hasattr(os, "getuid") else 0
    root = Path(tempfile.gettempdir()) / f"particlerb-{user}"
    try:
        root.mkdir(mode=0o700, exist_ok=True)
        status = root.lstat()
        if not root.is_symlink() and status.st_uid == user and not status.st_mode & 0o022:
            return root
        return Path(tempfile.mkdtemp(prefix="particlerb-"))
    except OSError:
        return root / "nowhere"  # nothing will be kept in it


def cache_folder() -> Path:
    """Folder of this version's compiled code; making it prunes those of old versions."""
    root = cache_root()
    folder = root / source_hash()
    with contextlib.suppress(OSError):  # said where the first kernel is to be kept
        if not folder.exists():
            folder.mkdir(parents=True, exist_ok=True)
            _prune(root, folder)
        os.utime(folder)  # now in use: the oldest are pruned first
    return folder


def _prune(root: Path, folder: Path) -> None:
    """Delete the folders that were not used for longest; another process may do so too."""
    used: list[tuple[float, Path]] = []
    for other in root.iterdir():
        with contextlib.suppress(OSError):
            if other.is_dir() and other != folder:
                used.append((other.stat().st_mtime, other))
    for _, old in sorted(used, reverse=True)[FOLDERS_KEPT - 1 :]:
        shutil.rmtree(old, ignore_errors=True)


CACHE_FOLDER = None if config.DISABLE_JIT else str(cache_folder())


@functools.cache
def warn_once(folder: str) -> None:
    """Say that compiled code is not kept in a folder."""
    error = sys.exc_info()[1]
    reason = getattr(error, "strerror", None) or error or "it cannot be written"
    text = f"compiled code cannot be kept in {folder} ({reason}): every start compiles again"
    warnings.warn(CacheWarning(f"{text}; NUMBA_CACHE_DIR names another folder"), stacklevel=2)


class _CheckedFiles(caching.IndexDataCacheFile):
    """Numba's files of a kernel, an index and its data, each with the SHA-256 of its content.

    Data also name what they are for: two processes may have chosen the same name at once.
    """

    def load(self, key: Any) -> Any:
        """What is kept for a key; None where there is nothing, or nothing whole."""
        entry = super().load(key)
        return entry[1] if entry is not None and entry[0] == key else None

    def save(self, key: Any, data: Any) -> None:
        """Keep something for a key."""
        super().save(key, (key, data))

    def _load_index(self) -> Any:
        head = pickle.dumps(self._version, protocol=-1)
        stamp, overloads = self.whole(self._index_path, head) or (None, {})
        return overloads if stamp == self._source_stamp else {}

    def _load_data(self, name: str) -> Any:
        return self.whole(self._data_path(name))

    def _dump(self, entry: Any) -> bytes:
        data: bytes = super()._dump(entry)
        return hashlib.sha256(data).digest() + data

    def whole(self, path: str, head: bytes = b"") -> Any:
        """Content of a file that begins so; None where it is not whole, and then it is deleted."""
        try:
            data = Path(path).read_bytes()
        except OSError:
            return None
        digest, content = data[len(head) : len(head) + 32], data[len(head) + 32 :]
        if data.startswith(head) and hashlib.sha256(content).digest() == digest:
            return pickle.loads(content)
        with contextlib.suppress(OSError):
            Path(path).unlink()
        return None


@functools.cache
def find_runtime() -> None:
    """Let code from disk find Numba's functions in C; those that are compiled it has itself."""
    for name, address in c_helpers.items():
        binding.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


class _KernelCache(caching.FunctionCache):
    """Numba's cache of a kernel, that never ends a run.

    A function may be kept in several ways, as a kernel and as a helper: each has a name there.
    """

    def __init__(self, dispatcher: Any) -> None:
        self._impl_class = KeptCode if isinstance(dispatcher, Helper) else KeptKernel
        super().__init__(dispatcher.py_func)
        name = self._impl.filename_base + getattr(dispatcher, "kept_as", ".alone")
        stamp = self._impl.locator.get_source_stamp()
        self._cache_file = _CheckedFiles(self._cache_path, name, stamp)

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Compiled code of a signature; None where there is none that can be used."""
        with contextlib.suppress(Exception):  # of unpickling and linking: it is compiled anew
            find_runtime()  # what only compiling takes besides is not loaded: 0.3 s
            if (overload := cast(Any, self)._load_overload(signature, context)) is not None:
                return overload
        while WHEN_COMPILING:
            _LOG.info("compiling %s ...", WHEN_COMPILING.pop())
        return None

    def has(self, signature: Any, context: Any) -> bool:
        """Whether the compiled code of a signature is kept."""
        files: Any = self
        return files._index_key(signature, context.codegen()) in self._cache_file._load_index()

    def is_empty(self) -> bool:
        """Whether no code is kept, of any signature."""
        return not Path(self._cache_file._index_path).exists()

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Keep the compiled code of a signature, if that can be."""
        try:
            try:
                super().save_overload(signature, compiled)
            except FileNotFoundError:  # another process has just pruned the folder
                super().save_overload(signature, compiled)
            os.utime(str(CACHE_FOLDER))  # in use: others are pruned first
        except pickle.PicklingError:  # of functions without a text
            return
        except OSError:
            warn_once(str(CACHE_FOLDER))


def keep(dispatcher: Any) -> None:
    """Let the compiled code of a kernel be kept in our folder, and in no other that Numba knows."""
    assert CACHE_FOLDER is not None
    before = config.CACHE_DIR
    config.CACHE_DIR = CACHE_FOLDER  # read while a cache is made, and for our code only
    try:
        cache = _KernelCache(dispatcher)
    except (OSError, RuntimeError):  # RuntimeError: there is no place for it
        warn_once(CACHE_FOLDER)
        return
    finally:
        config.CACHE_DIR = before
    if Path(cache.cache_path).is_relative_to(CACHE_FOLDER):
        dispatcher._cache = cache
    else:
        warn_once(CACHE_FOLDER)


def compile_with(**options: Any) -> Callable[[Function], Function]:
    """Return Numba's decorator with these options; the function's own type stays visible."""

    def decorate(function: Function) -> Function:
        if CACHE_FOLDER is None:
            return function
        return cast(Function, Dispatcher(function, _FLAGS | options, AloneCompiler, None))

    return decorate


def _helper(is_fused: bool = True, **options: Any) -> Callable[[Function], Function]:
    """Return a decorator for functions that are copied into their callers."""

    def decorate(function: Function) -> Function:
        if CACHE_FOLDER is None:
            return function
        is_ours = function.__code__.co_filename.startswith(f"{_PACKAGE}{os.sep}")
        kept = keep if is_ours else None  # the name of the folder covers no other text
        alone = unfused_kernel if is_ours else compile_with(**options)
        return cast(Function, Helper(function, _FLAGS | options, alone, kept, is_fused))

    return decorate


inline = _helper(forceinline=True)
unfused_inline = _helper(is_fused=False, forceinline=True)
splice = compile_with(inline="always")

unsigned: Any = int if config.DISABLE_JIT else np.uint64
"""An index that is not negative, so that Numba asks not whether it is; int where Python runs."""


def _kernel(made: type[Kernel], function: Function) -> Function:
    """A kernel of a class, kept on disk."""
    if CACHE_FOLDER is None:
        return function
    return cast(Function, made(function, _FLAGS, _helper(), keep))


def kernel(function: Function) -> Function:
    """A function that Python calls, or that kernels have once, and call."""
    return _kernel(Kernel, function)


def unfused_kernel(function: Function) -> Function:
    """A kernel that rounds each operation by itself, as Python does, which may run it: `plain`."""
    return _kernel(UnfusedKernel, function)


def kernel_from(template: Function, name: str, *instead: InPlaceOf, **constants: Any) -> Function:
    """Compile a kernel from a function that calls the second of each pair in place of the first.

    Its globals of the names of constants are to be these.

    A method brings its step, the loop around it is the same for all. Handed over as an argument,
    the step would be compiled and optimised once more on each level that it passes; as a closure
    it would never be found in the cache on disk. The kernel's name tells it there from the others.

    Raises
    ------
    NameError
        If the function never calls what is to be replaced, or has no such global.
    """
    function: Any = in_python(template, *instead, **constants)
    function.__name__, function.__qualname__ = name, f"{template.__qualname__}_{name}"
    return kernel(cast(Function, function))


def inline_from(source: str, file: str, name: str, names: dict[str, Any]) -> Callable[..., Any]:
    """A helper from a source, with these globals; messages call the source so."""
    linecache.cache[file] = len(source), None, source.splitlines(True), file  # for tracebacks
    names.setdefault("__name__", __name__)  # a module that the cache finds again
    exec(compile(source, file, "exec"), names)
    return inline(cast(Callable[..., Any], names[name]))


@contextlib.contextmanager
def compiling() -> Iterator[list[float]]:
    """Times that kernels take to be compiled until the end of the block [s]."""
    spent: list[float] = []
    with install_timer("numba:compile", spent.append):
        yield spent


def flag(is_present: bool) -> Flag:
    """What a kernel takes for something that is present or absent all the time."""
    return 1 if is_present else None


def for_types_of(function: Function, *arguments: Any) -> Function:
    """A kernel for arguments of the types of these alone: its calls do not look at them again.

    To look at nested tuples takes some 15 µs of a call.
    """
    if not isinstance(function, Kernel):  # in plain Python
        return function
    return cast(Function, cast(Any, function).compile(tuple(map(numba.typeof, arguments))))

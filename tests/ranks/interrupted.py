"""The program, whose second rank is interrupted once, while it imports the module MODULE."""

import importlib.abc
import os
import runpy
import sys


class _Interrupted(importlib.abc.MetaPathFinder):
    """Raises what an interrupt does."""

    def find_spec(self, name, path, target=None):
        """Interrupt there."""
        if name == os.environ["MODULE"]:
            sys.meta_path.remove(self)
            raise KeyboardInterrupt


if __name__ == "__main__":
    if os.environ.get("PMI_RANK") == "1":
        sys.meta_path.insert(0, _Interrupted())
    runpy.run_module("particlerb", run_name="__main__", alter_sys=True)

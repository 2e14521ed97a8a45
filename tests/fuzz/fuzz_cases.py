"""Feed the case reader with anything: a case or one clear error, every time.

    python tests/fuzz/fuzz_cases.py --runs 1000000          # mutations of the examples, fast
    python tests/fuzz/fuzz_cases.py --guided -runs=100000   # by coverage, with atheris

Number k of the first kind always gives the same text: `--only K` prints it and what becomes of it.
Each escape (another exception, an empty message, more than some seconds) is printed with its number
or, by atheris, written to a file. A text that is a case is also written as JSON, placed, and made
into bodies where it is small.
"""

import argparse
import os
import random
import re
import sys
import time
import warnings
from functools import cache
from pathlib import Path

os.environ["NUMBA_DISABLE_JIT"] = "1"  # nothing here is worth compiling

ROOT = Path(__file__).parents[2]
SECONDS_FOR_ONE = 5.0
LARGEST_SCENE = 20_000  # bodies or particles that are made
VALUES = """1e-320 nan inf -inf 1e999 -0.0 0 1 -1 2 0.5 1e308 1e100 9223372036854775807
    9223372036854775808 -9223372036854775809 1_000 0x10 0o7 true false "" "a" "world" "body" "all"
    "cube[0]" "a[99]" "initial" "random" '''x''' [] [0] [0,0,0] [1,0,0] [1,2,3,4] [0,0,0,0]
    [nan,0,0] [[0,0,0]] [[1,0,0],[0,1,0]] ["a","b"] {} {type="grid"} {type="box",size=[1,1,1]}
    {type="moments",inertia=[1,2,2]} {body=[1,0,0]} {random=1.0} {euler_deg=[0,0,0]} 1979-05-27
    07:32:00 "../../../../etc/passwd" "/dev/zero" "/dev/stdin" "\\u0000" "\\U0001F600" [1e300,1,1]
    [0.0,0.0] [0,1e-300] [5,1] 1e15 1e9 1e-9 1000000000000""".split()  # noqa: SIM905
BYTES = [b"\0", b"\xff", b"\xc3\x28", *(bytes([byte]) for byte in b"[]{}\"'=#\n\r.")]


BASE = """run = { t_end = 1.0, every = 0.5 }
[[body]]
name = "a"
mass = 1.0
shape = { type = "box", size = [1, 1, 1], n = 2 }
"""
SHAPES = """type = "ball", radius = 1.0, n = 3
type = "rod", length = 1.0, n = 3
type = "moments", inertia = [1, 2, 2.5]
type = "points", position = [[0, 0, 0], [1, 0, 0]], mass = [1, 2], radius = [0.1, 0]
type = "points", file = "points.csv"
type = "sphere", radius = 0.1
type = "cylinder", radius = 1.0, height = 2.0
type = "torus", radius = 2.0, tube = 0.5
type = "tetrahedron", edge = 1.0
type = "ellipsoid", axes = [1, 2, 3], arrangement = "exact\"""".splitlines()
PIECES = """velocity = [1, 0, 0]|angular_velocity = {{ body = [1, 2, 3] }}
count = 3|place = {{ type = "grid", spacing = 2.0, n = [3, 1, 1] }}|orientation = "random"
count = 2|place = {{ type = "random", lower = [0, 0, 0], upper = [1, 1, 1] }}
[gravity]|acceleration = [0, 0, -9.8]
[attraction]|G = 1.0|softening = 0.1|sum = "tree"|opening_angle = 0.5
[[force]]|type = "push"|body = "a"|at = [0, 0, 1]|force = [1, 0, 0]|during = [0.0, 0.5]
[[force]]|type = "torque"|body = "a"|torque = [1, 0, 0]|frame = "body"
[[force]]|type = "impulse"|body = "a"|impulse = [1, 0, 0]|time = 0.5
[[force]]|type = "drag"|body = "a"|translation = 1.0|rotation = 0.1
[[force]]|type = "spring"|body = "a"|anchor = [0, 0, 1]|stiffness = 1.0|rest_length = "initial"
[[force]]|type = "spring"|body = "a"|to = "a"|reach = 1.0|stiffness = 1.0|damping = 0.1
[[force]]|type = "field"|body = "a"|field = [0, 0, 1]|charge = [1, 2]|dipole = [1, 0, 0]
[[force]]|type = "central"|body = "a"|centre = [5, 0, 0]|mu = 1.0
[contact]|stiffness = 1e5|restitution = 0.5|friction = 0.3
[[wall]]|type = "plane"|normal = [0, 0, 1]
[[material]]|name = "m"|friction = 0.5|[[contact.pair]]|between = ["m", "m"]|friction = 0.1
[output]|fields = ["position", "orientation"]|dtype = "float32"
[check]|energy_drift = 1e-9
[[check.value]]|body = "a"|quantity = "position"|value = [0, 0, 0]|tolerance = 1.0
[chart]|[[chart.published]]|name = "x"|error = 1e-3""".replace("{{", "{").replace("}}", "}")


def small(dice: random.Random) -> str:
    """A case of a few lines: quick to read, so that many can be tried."""
    text = BASE
    if dice.random() < 0.3:
        text = text.replace('type = "box", size = [1, 1, 1], n = 2', dice.choice(SHAPES))
    pieces = PIECES.splitlines()
    return text + "\n".join(dice.choice(pieces).replace("|", "\n") for _ in range(2))


@cache
def seeds() -> list[bytes]:
    """Examples without their comments, and those of the page of keys."""
    texts = [path.read_text(encoding="utf-8") for path in sorted((ROOT / "cases").glob("*.toml"))]
    page = (ROOT / "docs" / "case.md").read_text(encoding="utf-8")
    texts += re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    bare = [re.sub(r"\s*#[^\n]*", "", text) for text in texts]
    return [text.encode() for text in bare if len(text) < 4000]


@cache
def keys() -> list[str]:
    """All keys and words of the schema."""
    from particlerb.case.schema import case_json_schema

    schema = case_json_schema()
    found: set[str] = set()
    for table in (schema, *schema["$defs"].values()):
        found |= set(table["properties"])
    return sorted(found)


@cache
def lines() -> list[str]:
    """All lines of the examples."""
    return sorted({line for seed in seeds() for line in seed.decode().splitlines() if line})


def mutated(k: int) -> bytes:
    """The k-th text."""
    dice = random.Random(k)
    large = dice.random() < 0.1
    rows = (dice.choice(seeds()).decode() if large else small(dice)).splitlines()
    for _ in range(dice.choice((1, 1, 2, 3, 6) if large else (0, 1, 1, 1, 2, 3))):
        at = dice.randrange(len(rows)) if rows else 0
        match dice.randrange(9):
            case 0:
                rows[at : at + 1] = []
            case 1:
                rows.insert(at, dice.choice(lines()))
            case 2:
                rows.insert(at, f"{dice.choice(keys())} = {dice.choice(VALUES)}")
            case 3 | 4 if rows:
                head, _, _ = rows[at].partition("=")
                rows[at] = f"{head}= {dice.choice(VALUES)}"
            case 5 | 6 if rows:
                numbers = list(re.finditer(r"[-+\w.]+", rows[at]))
                if numbers:
                    one = dice.choice(numbers)
                    word = dice.choice((*VALUES, *keys()))
                    rows[at] = rows[at][: one.start()] + word + rows[at][one.end() :]
            case 7 if len(rows) > 1:
                other = dice.randrange(len(rows))
                rows[at], rows[other] = rows[other], rows[at]
            case 8:
                rows[at : at + dice.randrange(1, 8)] = []
    data = bytearray("\n".join(rows).encode())
    if data and dice.random() < 0.15:
        for _ in range(dice.choice((1, 2, 8))):
            at = dice.randrange(len(data) + 1)
            data[at : at + dice.choice((0, 1, 3))] = dice.choice(BYTES)
    return bytes(data)


def check(data: bytes) -> str:
    """What becomes of a text; raises where it is neither a case nor a CaseError."""
    from particlerb.case.problems import CaseError
    from particlerb.case.reader import parse

    warnings.simplefilter("error")  # a warning of NumPy is an escape too
    start = time.process_time()
    try:
        case = parse(data.decode(errors="replace"), Path("case.toml"))
        case.model_dump_json()
        outcome = "case"
        if is_small(case):
            from particlerb.bodies.scene import assemble

            assemble(case)
            outcome = "bodies"
    except CaseError as error:
        words = str(error)
        if not error.problems or not words.strip() or "case.toml" not in words:
            raise AssertionError(f"a poor message: {words!r}") from None
        outcome = "error"
    if time.process_time() - start > SECONDS_FOR_ONE:
        raise AssertionError(f"took {time.process_time() - start:.1f} s")
    return outcome


def is_small(case: object) -> bool:
    """Whether a case makes few bodies of few particles."""
    text = case.model_dump_json()  # type: ignore[attr-defined]
    product = 1.0
    for numbers in re.findall(r'"n":\[?([\d.,e+]+)', text):
        for number in filter(None, numbers.split(",")):
            product *= max(float(number), 1.0)
    return case.n_bodies < LARGEST_SCENE and product < LARGEST_SCENE  # type: ignore[attr-defined]


def run(first: int, runs: int) -> int:
    """Try numbers one after the other; return how many escaped."""
    escapes, counts, start = 0, {"case": 0, "bodies": 0, "error": 0}, time.monotonic()
    for k in range(first, first + runs):
        try:
            counts[check(mutated(k))] += 1
        except Exception as error:
            escapes += 1
            print(k, type(error).__name__, " ".join(str(error).split())[:200], flush=True)
        if k % 10_000 == 9_999:
            print(f"{k + 1 - first} texts, {counts}", flush=True)
    rate = runs / (time.monotonic() - start)
    print(f"{runs} texts, {rate:.0f} a second, {counts}, {escapes} escapes")
    return escapes


def guided(words: list[str]) -> None:
    """Let atheris look for new ways through the reader."""
    import tempfile

    import atheris

    with atheris.instrument_imports(include=["particlerb.case", "tomllib"]):
        import particlerb.case.reader  # noqa: F401

    def one(data: bytes) -> None:
        check(data)

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for number, seed in enumerate(seeds()):
            (folder / str(number)).write_bytes(seed)
        tokens = [*keys(), *(value for value in VALUES if '"' not in value and "\\" not in value)]
        (folder / "words.dict").write_text("".join(f'"{word}"\n' for word in tokens))
        atheris.Setup([sys.argv[0], f"-dict={folder}/words.dict", *words, name], one)
        atheris.Fuzz()


def main() -> None:
    """Fuzz, or show one text."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", type=int)
    parser.add_argument("--guided", action="store_true")
    options, words = parser.parse_known_args()
    if options.guided:
        guided(words)
    elif options.only is not None:
        print(mutated(options.only).decode(errors="replace"))
        print(check(mutated(options.only)))
    else:
        sys.exit(run(options.first, options.runs) > 0)


if __name__ == "__main__":
    main()

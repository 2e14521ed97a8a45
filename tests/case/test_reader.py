"""Reading good cases, overrides, positions and the look of messages; fuzzing of all of it."""

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from particlerb.case.positions import extents
from particlerb.case.problems import key_of, path_of, problem_at
from particlerb.case.reader import CaseError, load, parse

pytestmark = pytest.mark.once

TEXT = """\
title = "two cubes"   # a comment with "quotes" and [brackets]

[run]
t_end = 5.0
every = 0.1
method = "strang"

[gravity]
acceleration = [0, 0, -9.81]

[[body]]
name = "cube"
shape = { type = "box", size = [1.0, 2.0, 3.0], n = 4 }
mass = 2.0
orientation = { euler_deg = [10, 20, 30] }
angular_velocity = { body = [0, 0, 1] }

[[body]]
name = "dumb bell"
[[body.part]]
shape = { type = "ball", radius = 0.5 }
mass = 1.0
position = [0, 0, 1]
[[body.part]]
shape.type = "points"
shape.position = [
  [0, 0, 0],  # first
  [0, 0, 1],
]
shape.mass = [1, 2]

[[force]]
type = "impulse"
body = ["cube", "dumb bell[0]"]
impulse = [0, 0, 1]
time = 5.0

[[check.value]]
body = "cube"
quantity = "inertia"
value = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
tolerance = 1e-3
"""


def test_case_as_written():
    case = parse(TEXT)
    cube, bell = case.body
    assert case.run.t_end == 5.0
    assert case.run.method == "strang"
    assert case.gravity is not None
    assert case.gravity.acceleration == (0.0, 0.0, -9.81)
    assert cube.shape.n == (4, 4, 4)
    assert cube.orientation.euler_deg == (10, 20, 30)
    assert cube.angular_velocity.body == (0, 0, 1)
    assert bell.part[1].shape.position == ((0, 0, 0), (0, 0, 1))
    assert case.force[0].body == ("cube", "dumb bell[0]")
    assert case.check.value[0].value[2] == (0, 0, 1)


def test_defaults_are_the_expected_ones():
    body = {"name": "a", "shape": {"type": "ball", "radius": 1}, "mass": 1}
    case = load({"run": {"t_end": 1, "every": 1}, "body": [body]})
    assert (case.run.method, case.run.dt, case.run.seed, case.run.threads) == (
        "auto",
        None,
        0,
        None,
    )
    assert (case.gravity, case.force, case.check.value, case.title) == (None, (), (), "")
    assert case.body[0].position == case.body[0].velocity == (0, 0, 0)
    assert case.body[0].orientation == (1, 0, 0, 0)
    assert case.body[0].shape.n == 10
    assert case.output.fields == (
        "position", "orientation", "linear_momentum", "angular_momentum"
    )  # fmt: skip
    assert (case.source.text, case.path) == ("", None)


def test_case_keeps_its_text_path_and_folder(tmp_path):
    path = tmp_path / "two.toml"
    path.write_text(TEXT)
    case = load(str(path))
    assert (case.source.text, case.path) == (TEXT, path)
    (tmp_path / "a.csv").write_text("1")
    assert case.source.files.read("a.csv") == (str(tmp_path / "a.csv"), b"1")
    assert case.source.files.read(str(path)) == (str(path), TEXT.encode())
    with pytest.raises(ValueError, match=r'there is no file "a\.csv" in \.$'):
        parse(TEXT).source.files.read("a.csv")
    assert sum(body.count for body in case.body) == 2


def test_case_is_frozen():
    case = parse(TEXT)
    with pytest.raises(AttributeError, match="cannot be set"):
        case.run.t_end = 6.0


def test_resolved_case_is_json_that_gives_the_case_back(everything):
    rows = {"count": 2, "position": np.array([[0.0, 0, 0], [0.1, 0, 0]]), "velocity": {"random": 1}}
    for case in (parse(TEXT), load(everything())):
        resolved = json.loads(case.model_dump_json())
        assert json.loads(load(resolved).model_dump_json()) == resolved
    body = {"name": "a", "shape": {"type": "ball", "radius": 1}, "mass": 1, **rows}
    case = load({"run": {"t_end": 1, "every": 1}, "body": [body]})
    resolved = json.loads(case.model_dump_json())
    assert resolved["body"][0]["position"] == [[0, 0, 0], [0.1, 0, 0]]
    np.testing.assert_array_equal(load(resolved).body[0].position, rows["position"])
    spheres = {"type": "spheres", "position": [[0, 0, 0], [1, 0, 0]], "radius": 1}
    case = load({"run": {"t_end": 1, "every": 1}, "body": [body | {"shape": spheres}]})
    load(json.loads(case.model_dump_json()))  # so `resume` and `view` read the file of a run


def test_values_from_python_may_be_arrays_and_numpy_numbers():
    body = {
        "name": "a",
        "shape": {"type": "points", "position": np.eye(3), "mass": np.ones(3)},
        "position": np.array([1, 2, 3]),
        "orientation": np.array([2.0, 0, 0, 0]),
    }
    case = load({"run": {"t_end": np.float64(1), "every": np.float32(0.5)}, "body": (body,)})
    assert case.body[0].position == (1, 2, 3)
    assert case.body[0].shape.mass == (1, 1, 1)


def test_rows_are_a_copy_that_cannot_be_written():
    rows = np.zeros((2, 3))
    body = {"name": "a", "shape": {"type": "ball", "radius": 1}, "mass": 1, "count": 2}
    case = load({"run": {"t_end": 1, "every": 1}, "body": [body | {"position": rows}]})
    rows[0, 0] = 1.0
    kept = case.body[0].position
    assert isinstance(kept, np.ndarray)
    assert kept[0, 0] == 0.0
    assert not kept.flags.writeable


def test_limits_belong_to_what_is_allowed(everything):
    case = everything()
    case["run"] |= {"every": 5, "seed": 2**63 - 1, "threads": 2**31 - 1}
    case["body"][5]["shape"]["minor_radius"] = 2
    case["body"][2]["place"]["n"] = [1, 2, 1]
    case["body"][3]["place"]["upper"] = [0, 0, 0]
    case["force"][2]["time"] = case["check"]["value"][0]["time"] = 5
    case["check"]["value"][0]["value"] = np.zeros(3)
    assert load(case).body[5].shape.minor_radius == 2
    for value in ([1, 2, 3], np.eye(3), [[1, 0, 0]] * 3):
        case["check"]["value"][0] |= {"quantity": "inertia", "frame": "body", "value": value}
        assert load(case).check.value[0].value == tuple(
            tuple(v) if isinstance(v, (list, np.ndarray)) else v for v in value
        )
    case["check"]["value"][0] |= {"quantity": "kinetic_energy", "frame": "world", "value": 2}
    assert load(case).check.value[0].value == 2.0


# Overrides


@pytest.mark.parametrize(
    ("override", "value"),
    [
        ("run.dt=1e-4", lambda c: c.run.dt == 1e-4),
        ("run.dt = 1e-4", lambda c: c.run.dt == 1e-4),
        ("run.method=exact", lambda c: c.run.method == "exact"),
        ("body.0.mass=3", lambda c: c.body[0].mass == 3.0),
        ("body[0].mass=3", lambda c: c.body[0].mass == 3.0),
        ("body.1.part.0.shape.radius=2", lambda c: c.body[1].part[0].shape.radius == 2.0),
        ("body.0.shape.size.2=9", lambda c: c.body[0].shape.size == (1.0, 2.0, 9.0)),
        ("output.dtype=float32", lambda c: c.output.dtype == "float32"),
        ("title=a = b", lambda c: c.title == "a = b"),
        ('title="7"', lambda c: c.title == "7"),
        ("body.0.velocity=[1, 0, 0]", lambda c: c.body[0].velocity == (1, 0, 0)),
        ('body.0.shape={type="ball", radius=1}', lambda c: c.body[0].shape.type == "ball"),
    ],
)
def test_override(override, value):
    case = parse(TEXT, overrides=[override])
    assert value(case)
    assert not value(parse(TEXT))


def test_overrides_of_a_case_keep_earlier_ones_and_leave_it_alone():
    first = parse(TEXT, overrides=["run.t_end=7"])
    second = load(first, ["run.every=7"])
    assert (second.run.t_end, second.run.every) == (7, 7)
    assert (first.run.every, first.source.raw["run"]["every"]) == (0.1, 0.1)
    assert load(first) is first


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("run.dt=-1", "--set run.dt: error: run.dt: must be > 0, got -1"),
        ("run.dtt=1", "--set run.dtt: error: run.dtt: unknown key"),
        ("run.dt", "--set run.dt: error: run.dt: must have the form key=value"),
        ("run..dt=1", "--set run..dt: error: run..dt: unknown key"),
        ("=1", "--set : error: must have the form key=value"),
        ("body.2.mass=1", "--set body.2.mass: error: body[2].mass: there is no entry 2 of 2"),
        ("body[-1].mass=1", "--set body[-1].mass: error: body[-1].mass: there is no entry -1 of 2"),
        ("joint[0].motor=1", "joint[0].motor: there is no entry 0 of 0, counted from 0"),
        ("body.x.mass=1", "no entry 'x' of 2, counted from 0 as in body.0"),
        ("run.t_end.x=1", "--set run.t_end.x: error: run.t_end.x: there is no 'x' in 5.0"),
        ("title=0.5", "--set title: error: title: must be a text, got a number: 0.5"),
    ],
)
def test_wrong_override_is_named(override, message):
    with pytest.raises(CaseError) as caught:
        parse(TEXT, Path("a.toml"), [override])
    assert message in str(caught.value)
    assert len(caught.value.problems) == 1


# Positions and messages


def test_message_is_the_promised_one():
    with pytest.raises(CaseError) as caught:
        parse(TEXT.replace("every", "evry"), Path("cube.toml"))
    assert str(caught.value) == (
        "cube.toml:5:1: error: run.evry: unknown key\n"
        "    5 | evry = 0.1\n"
        "      | ^^^^\n"
        '      hint: did you mean "every"? keys here: t_end, every, method, dt, tolerance,'
        " accuracy, seed, threads"
    )


@pytest.mark.parametrize(
    ("key", "line", "column", "marked"),
    [
        ("title", 1, 9, '"two cubes"'),
        ("run", 3, 1, "[run]"),
        ("run.dt", 3, 1, "[run]"),
        ("gravity.acceleration[2]", 9, 23, "-9.81"),
        ("body", 11, 1, "[[body]]"),
        ("body[0]", 11, 1, "[[body]]"),
        ("body[1]", 18, 1, "[[body]]"),
        ("body[0].shape", 13, 9, '{ type = "box", size = [1.0, 2.0, 3.0], n = 4 }'),
        ("body[0].shape.size[1]", 13, 38, "2.0"),
        ("body[0].shape.arrangement", 13, 1, "shape"),
        ("body[1].part[1]", 24, 1, "[[body.part]]"),
        ("body[1].part[1].shape.mass[1]", 30, 18, "2"),
        ("body[1].part[1].shape.position[1]", 28, 3, "[0, 0, 1]"),
        ("force[0].body[1]", 34, 17, '"dumb bell[0]"'),
        ("check.value[0].value[2][2]", 41, 39, "1"),
        ("nothing.like.it", 1, 1, ""),
    ],
)
def test_problem_of_a_later_stage_is_shown_in_the_file(key, line, column, marked):
    problem = problem_at(parse(TEXT, Path("a.toml")), key, "too large", "smaller")
    assert (problem.file, problem.line, problem.column) == ("a.toml", line, column)
    assert (problem.key, problem.reason, problem.hint) == (key, "too large", "smaller")
    start = column - 1
    assert problem.source[start : start + problem.length] == marked or not marked


def test_problem_has_the_value():
    case = parse(TEXT)
    assert problem_at(case, "body[0].mass", "too large").value == "2.0"
    assert problem_at(case, "run.seed", "odd").value == ""
    assert len(problem_at(load(case, [f"title={'x' * 99}"]), "title", "long").value) == 60


def test_problem_of_an_overridden_key_names_the_override():
    problem = problem_at(parse(TEXT, overrides=["run.dt=9"]), "run.dt", "too long")
    assert str(problem) == "--set run.dt: error: run.dt: too long"


def test_long_line_is_cut_round_the_mistake():
    numbers = ", ".join(["[0, 0, 0]"] * 300 + ["[0, nan, 0]"] + ["[0, 0, 0]"] * 300)
    text = TEXT.replace("[0, 0, 0],  # first", f"{numbers},")
    with pytest.raises(CaseError) as caught:
        parse(text)
    lines = str(caught.value).splitlines()
    assert all(len(line) < 200 for line in lines)
    assert lines[1][lines[2].index("^") :].startswith("nan")
    assert lines[2].count("^") == 3
    case = parse(TEXT.replace("two cubes", "cubes " * 100))
    _, line, marks = str(problem_at(case, "title", "too long")).splitlines()
    assert len(marks) == len(line)


def test_very_long_files_have_messages_without_lines(monkeypatch):
    monkeypatch.setattr("particlerb.case.problems.LONGEST_SCANNED", len(TEXT) - 1)
    problem = problem_at(parse(TEXT, Path("a.toml")), "run.dt", "too long")
    assert str(problem) == "a.toml: error: run.dt: too long"
    monkeypatch.setattr("particlerb.case.problems.LONGEST_SCANNED", len(TEXT))
    assert problem_at(parse(TEXT, Path("a.toml")), "run.dt", "too long").line == 3


@pytest.mark.parametrize("prefix", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_line_ends_and_byte_order_mark_do_not_matter(tmp_path, prefix, ending):
    path = tmp_path / "a.toml"
    path.write_bytes(prefix + TEXT.replace("t_end", "tend").replace("\n", ending).encode())
    with pytest.raises(CaseError) as caught:
        load(path)
    (problem,) = caught.value.problems
    assert (problem.line, problem.column, problem.source) == (4, 1, "tend = 5.0")


def test_text_that_a_terminal_cannot_show_is_escaped():
    for override in ("body.0.name=\udcff", "run.x\udcff", "run.x\udcff=1"):
        with pytest.raises(CaseError) as caught:
            parse(TEXT, Path("\udcff.toml"), [override])
        assert "\\udcff" in str(caught.value)
        str(caught.value).encode("utf-8")


def test_message_never_holds_control_characters_or_megabytes():
    text = TEXT.replace('body = "cube"', 'body = "\\u001b[2J\\n"')
    text = text.replace("t_end", f'"\\u001b]0;" = 1\n{"x" * 10**6} = 1\nt_end')
    with pytest.raises(CaseError) as caught:
        parse(text, Path("a\x1bb.toml"))
    shown = str(caught.value)
    assert len(caught.value.problems) == 3
    assert len(shown) < 4000
    assert all(line.isprintable() for line in shown.split("\n"))
    assert '"\\x1b[2J\\n"' in shown


def test_names_can_be_written_and_told_apart():
    """HDF5 would end a name at a NUL: two walls would have the same one."""
    wall = {"type": "plane", "name": "a\0", "normal": [0, 0, 1]}
    joint = {"type": "ball", "name": "a\nb", "body": "cube"}
    named = {"wall": [wall], "joint": [joint], "material": [{"name": "\t"}]}
    with pytest.raises(CaseError) as caught:
        load({"run": {"t_end": 1.0, "every": 1.0}, "body": [{"name": "cube"}], **named})
    wrong = {p.key for p in caught.value.problems if p.reason == "must be printable"}
    assert wrong == {"wall[0].name", "joint[0].name", "material[0].name"}


def test_keys_and_paths():
    path = ("body", 0, "shape", "size", 1)
    assert key_of(path) == "body[0].shape.size[1]"
    assert path_of("body[0].shape.size[1]") == path_of("body.0.shape.size.1") == path


KEYS = st.from_regex(r"[a-z_]{1,4}", fullmatch=True)
QUOTED = st.sampled_from(['"a b"', "'c.d'", '"e\\"f"', '"\\u00e9"', '"#"', '"="'])
SCALARS = st.sampled_from(
    ["1", "-1.5e3", "true", '"x"', "'y'", '"#]}"', '"""a\nb"]"""', "'''c''\n[x]\n'''",
     '"\\\\"', "1979-05-27 07:32:00", "nan", '""""q"""""']
)  # fmt: skip


@st.composite
def tables(draw, depth=0):
    """Lines of a valid table, without repeated keys."""
    keys = draw(st.lists(KEYS | QUOTED, max_size=3, unique_by=lambda k: k))
    return [f"{key} = {draw(values(depth))}" for key in keys]


def values(depth):
    if depth == 2:
        return SCALARS
    lists = st.lists(st.deferred(lambda: values(depth + 1)), max_size=3)
    arrays = lists.map(lambda v: "[ # [\n" + ",\n ".join(v) + "\n]")
    inline = tables(depth + 1).map(
        lambda lines: "{ " + ", ".join(line.replace("\n", " ") for line in lines) + " }"
    )
    return SCALARS | arrays | inline


@st.composite
def documents(draw):
    """Text with keys, tables, arrays of tables and tables inside these."""
    lines = draw(tables())
    for name in draw(st.lists(st.sampled_from(["T", "U.V"]), unique=True)):
        lines += [f"[ {name} ] # [x]", *draw(tables()), f'X{draw(st.integers(0, 9))}."y z".t = 1']
    for _ in range(draw(st.integers(0, 3))):
        lines += ["[[A]]", *draw(tables())]
        lines += ["[A.'S']", *draw(tables())] if draw(st.booleans()) else []
        lines += ["[[A.B]]", *draw(tables())] * draw(st.integers(0, 2))
    return "\n".join(lines)


def paths_in(node, path=()):
    """All paths of nested data."""
    if path:
        yield path
    for key, entry in node.items() if isinstance(node, dict) else ():
        yield from paths_in(entry, (*path, key))
    for i, entry in enumerate(node) if isinstance(node, list) else ():
        yield from paths_in(entry, (*path, i))


@pytest.mark.slow
@settings(deadline=None, max_examples=150)
@given(documents())
def test_scanner_finds_exactly_what_tomllib_reads(text):
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError:  # a line end that the strategy put into an inline table
        return
    found = extents(text)
    assert set(found) == set(paths_in(data))
    for path in found:
        start, end = found[path].value
        node = data
        for part in path:
            node = node[part]
        if not isinstance(node, (dict, list)):
            again = tomllib.loads(f"v = {text[start:end]}")["v"]
            assert again == node or again != again


# Fuzzing


def outcome(text):
    """A case, or an error whose text can be shown; anything else is a bug."""
    try:
        parse(text)
    except CaseError as error:
        str(error).encode("utf-8")


@settings(deadline=None, max_examples=200)
@given(st.text(alphabet=st.characters(), max_size=200))
def test_any_text_is_a_case_or_an_error(text):
    outcome(text)


WORDS = ["nan", "-inf", "true", '"x"', "[1, 2]", "{a = 1}", '{type = "ball"}', "[[1, 2, 3]]", "0",
         "1e400", "9" * 30, "1979-05-27", '""', "[]", "{}", '"cube[9]"', "'''a\nb'''", "[[body]]",
         "\n", "[", "}", '"', "a.b", "[check]", "body", "type", "shape", "=",
         "-1", "\\"]  # fmt: skip
SPLIT = [
    w for w in TEXT.replace("[", " [ ").replace("]", " ] ").replace("\n", " \n ").split(" ") if w
]


@settings(deadline=None, max_examples=300)
@given(st.data())
def test_a_mutated_case_is_a_case_or_an_error(data):
    words = list(SPLIT)
    for _ in range(data.draw(st.integers(1, 3))):
        i = data.draw(st.integers(0, len(words) - 1))
        words[i : i + data.draw(st.integers(0, 2))] = [data.draw(st.sampled_from(WORDS))]
    outcome(" ".join(words))


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(
                ["run", "body", "force", "shape", "type", "name", "body", "t_end", "place"]
            ),
            inner,
            max_size=4,
        )
    ),
)


@settings(deadline=None, max_examples=200)
@given(st.data())
def test_any_data_in_place_of_an_entry_is_a_case_or_an_error(data):
    case = tomllib.loads(TEXT)
    path = data.draw(st.sampled_from(list(paths_in(case))))
    node = case
    for part in path[:-1]:
        node = node[part]
    node[path[-1]] = data.draw(JSON)
    try:
        load(case)
    except CaseError as error:
        str(error).encode("utf-8")


def test_data_that_contains_itself_is_an_error():
    case = tomllib.loads(TEXT)
    case["run"]["dt"] = case
    with pytest.raises(CaseError, match="nested too deeply"):
        load(case)


def test_many_problems_are_not_all_shown():
    numbers = ", ".join(["-1"] * 20_000)
    with pytest.raises(CaseError) as caught:
        parse(TEXT.replace("shape.mass = [1, 2]", f"shape.mass = [{numbers}]"), Path("a.toml"))
    assert len(caught.value.problems) == 101
    assert str(caught.value).endswith("a.toml: error: 19900 more problems are not shown")


def test_many_names_are_not_all_listed():
    case = tomllib.loads(TEXT)
    case["body"] = [{**case["body"][0], "name": f"b{i}"} for i in range(50)]
    with pytest.raises(CaseError) as caught:
        load(case)
    assert caught.value.problems[0].hint.endswith("b18, b19, ... (50 in all)")


# Imports


def test_reading_needs_no_compiler():
    code = "import sys, particlerb.case.reader, particlerb.case.placement as p; print(*sys.modules)"
    modules = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert not {"numba", "h5py", "matplotlib", "scipy"} & set(modules)

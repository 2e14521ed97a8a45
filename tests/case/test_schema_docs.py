"""docs/case.md lists exactly the keys of the schema; the JSON schema describes each of them.

`python tests/case/test_schema_docs.py` prints the tables of the page.
"""

import json
import re
from pathlib import Path

import pytest

from particlerb.case.bodies import AnyPlace
from particlerb.case.contact import AnyWall
from particlerb.case.forces import FORCE_TABLES
from particlerb.case.reader import load
from particlerb.case.run import METHOD_CHOICES
from particlerb.case.schema import case_json_schema
from particlerb.case.shapes import SHAPES
from particlerb.case.values import by_type

PAGE = Path(__file__).parents[2] / "docs" / "case.md"
SCHEMA = case_json_schema()
HEADINGS = {
    "Top level": "Case",
    "[run]": "RunTable",
    "[gravity]": "Gravity",
    "[attraction]": "AttractionTable",
    "[[body]]": "Body",
    "[[body.part]]": "ShapePart",
    "orientation = { euler_deg = [..] }": "Euler",
    "velocity, angular_velocity = { body = [..] }": "InBody",
    "velocity, angular_velocity = { random = v }": "NormalDistribution",
    **{f"place: {name}": model.__name__ for name, model in by_type(AnyPlace).items()},
    **{f"shape: {name}": model.__name__ for name, model in SHAPES.items()},
    **{f"force: {name}": model.__name__ for name, model in FORCE_TABLES.items()},
    "force and torque by knots": "TimedLoad",
    "[[joint]]": "JointTable",
    "at, axis of a joint = { body = [..] }": "InFrame",
    "spring of a joint": "JointSpring",
    "limit of a joint": "JointLimit",
    "motor of a joint": "JointMotor",
    "drive of a joint": "JointDrive",
    "breaks_at of a joint": "JointLoad",
    "[contact]": "ContactTable",
    "[[contact.pair]]": "Pair",
    "[[material]]": "Material",
    **{f"wall: {name}": model.__name__ for name, model in by_type(AnyWall).items()},
    "motion of a wall or a body": "Prescribed",
    "oscillation of a wall or a body": "Oscillation",
    "piston of a wall": "Piston",
    "[output]": "Output",
    "[check]": "Check",
    "[[check.value]]": "CheckValue",
    "[sweep]": "SweepTable",
    "axis of a sweep: { low = .., high = .. }": "Spread",
    "[[sweep.value]]": "SweepValue",
    "[chart]": "ChartTable",
    "[[chart.published]]": "Published",
}
HEAD = "| key | type | unit | default | meaning |"


def type_words(schema: dict) -> str:
    """Type of a JSON schema in words: `3 numbers > 0 or number > 0`."""
    for union in ("anyOf", "oneOf"):
        if union in schema:
            words = [type_words(one) for one in schema[union] if one.get("type") != "null"]
            return " or ".join(dict.fromkeys(words))
    if "$ref" in schema:
        return "table"
    if "enum" in schema or "const" in schema:
        return ", ".join(f"`{json.dumps(c)}`" for c in schema.get("enum", [schema.get("const")]))
    if "prefixItems" in schema:
        return f"{schema['minItems']} {plural(type_words(schema['prefixItems'][0]))}"
    if schema["type"] == "array":
        return f"list of {plural(type_words(schema['items']))}"
    word = {"string": "text", "object": "table"}.get(schema["type"], schema["type"])
    if "exclusiveMinimum" in schema:
        return f"{word} > {schema['exclusiveMinimum']}"
    return f"{word} >= {schema['minimum']}" if "minimum" in schema else word


def plural(words: str) -> str:
    if words[0].isdigit() or words.startswith(("list", "`")):
        return f"({words})"
    first = words.split(maxsplit=1)[0]
    return words.replace(first, f"{first}s", 1)


def default_words(key: str, schema: dict, required: list[str]) -> str:
    if key in required:
        return "required"
    default = schema.get("default")
    if default is None:
        return "-"
    text = re.sub(r"\.0(?!\d)", "", json.dumps(default))
    return f"`{text}`"


def rows(model: str) -> list[str]:
    """Rows of the table of a model in the page."""
    table = SCHEMA if model == "Case" else SCHEMA["$defs"][model]
    found = []
    for key, schema in table["properties"].items():
        meaning, unit = re.fullmatch(r"(.*?)\.? \[([^\[\]]*)\]", schema["description"]).groups()
        default = default_words(key, schema, table.get("required", []))
        found.append(f"| `{key}` | {type_words(schema)} | {unit} | {default} | {meaning} |")
    return found


def sections() -> dict[str, str]:
    """Text of the page by heading."""
    parts = re.split(r"^#+ (.*)\n", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def test_every_table_of_the_schema_has_a_heading():
    assert set(HEADINGS.values()) == {"Case", *SCHEMA["$defs"]}


@pytest.mark.parametrize("heading", HEADINGS)
def test_page_lists_the_keys_of_the_table(heading):
    text = sections()[heading]
    assert [line for line in text.splitlines() if line.startswith("| `")] == rows(HEADINGS[heading])
    assert HEAD in text


def test_page_has_no_table_beside_these():
    assert {name for name, text in sections().items() if HEAD in text} == set(HEADINGS)


def test_examples_of_the_page_are_good_cases(tmp_path):
    examples = re.findall(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert examples
    for example in examples:
        (tmp_path / "example.toml").write_text(example)
        load(tmp_path / "example.toml")


def test_json_schema_is_closed_and_describes_everything():
    assert SCHEMA["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    for table in [SCHEMA, *SCHEMA["$defs"].values()]:
        assert table["additionalProperties"] is False
        assert table["description"]
        assert all("description" in schema for schema in table["properties"].values())
    assert SCHEMA["$defs"]["RunTable"]["properties"]["method"]["enum"] == list(METHOD_CHOICES)
    json.dumps(SCHEMA)


if __name__ == "__main__":
    for title, name in HEADINGS.items():
        print(f"## {title}\n", HEAD, "| --- | --- | --- | --- | --- |", *rows(name), "", sep="\n")

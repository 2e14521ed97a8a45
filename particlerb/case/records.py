"""Tables of a case that Python code makes: checked alone, with the words of a case file."""

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from particlerb.case.messages import messages_of, names_of, without_typos
from particlerb.case.problems import CaseError
from particlerb.case.source import Locator, Source
from particlerb.case.values import Table, plain


def fill(record: Table, keys: Mapping[str, Any]) -> None:
    """Give a new table its keys; `type` is known where the class says it.

    Raises
    ------
    CaseError
        With all that is wrong with the table alone. What involves others shows when it is run.
    """
    table, raw = type(record), plain(keys, keeps_tables=True)
    kind = table.model_fields.get("type")
    if kind is not None and kind.init is False:
        raw.setdefault("type", names_of(table)[0])
    try:
        table.__pydantic_validator__.validate_python(raw, self_instance=record)
    except ValidationError as error:
        found = without_typos(messages_of(raw, error.errors(include_url=False), table))
        locator = Locator(Source(raw=raw))
        problems = [locator.problem(*one) for one in found]
        raise CaseError(one._replace(file=table.__name__) for one in problems) from None

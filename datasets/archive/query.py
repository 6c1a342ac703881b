"""The language of ``stillpoint archive find``: conditions joined by and, or, not, and brackets.

    rate > 100 and has:mag and tag:fast and duration > 60 and sensor ~ 'iphone'

A condition is ``FIELD OPERATOR VALUE`` (``=``, ``!=``, ``<``, ``<=``, ``>``, ``>=``; ``~`` contains, ``!~`` does not,
case aside), ``has:STREAM``, ``tag:NAME``, ``kind:NAME``, ``id:PREFIX``, ``meta.KEY OPERATOR VALUE``, ``rate.STREAM
OPERATOR VALUE``, or a word alone, which is looked for in the name. ``all`` finds everything. The grammar becomes SQL
whose values are parameters; no text of the user becomes SQL.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

from stillpoint.datasets.archive.catalogue import DESCRIBED, NUMBERS, SCORE_FIGURES
from stillpoint.datasets.errors import BadParameter, nearest

_GRAMMAR = r"""
start: alternatives
?alternatives: conditions ("or"i conditions)*
?conditions: condition ("and"i condition)*
?condition: "not"i condition -> negation
    | "(" alternatives ")"
    | NAME OPERATOR value -> comparison
    | NAME ":" value -> label
    | value -> anywhere
value: NUMBER | QUOTED | NAME | WORD
OPERATOR: "!=" | "<=" | ">=" | "!~" | "=" | "<" | ">" | "~"
NUMBER.4: /[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?(?![\w.:-])/
NAME.3: /(?!(and|or|not)\b)[a-z_][\w]*(\.[\w-]+)?(?![\w.-])/i
WORD.2: /(?!(and|or|not)\b)[\w.+*\/-]+/i
QUOTED: /'[^']*'/ | /"[^"]*"/
%ignore /\s+/
"""
_FIELDS = {
    **{name: f"o.{name}" for name in ("kind", "name", "file_name", "size", "added", "problem", *DESCRIBED)},
    "rate": "o.rate_hz",
    "duration": "o.duration_s",
    "license": "o.licence",
    "sd": "o.sd_median_deg",
    "file": "o.file_name",
    "latitude": "o.latitude_deg",
    "longitude": "o.longitude_deg",
}
_OF_STREAMS = {
    "rate": "rate_hz", "samples": "samples", "length": "length_s", "gaps": "gaps", "longest_gap": "longest_gap_s",
}  # fmt: skip
_LABELS = ("has", "tag", "kind", "id", "is")
_SQL = {"=": "=", "!=": "!=", "<": "<", "<=": "<=", ">": ">", ">=": ">="}
_CONTAINS = "instr(lower({}), lower(?)) > 0"


@dataclass(frozen=True)
class Condition:
    """A condition on ``objects o`` in SQL, and the values of its parameters."""

    sql: str
    parameters: tuple[Any, ...] = ()


def parse_query(text: str) -> Condition:
    """Return the SQL condition of a query; raises :class:`BadParameter` with the place that cannot be understood."""
    from lark.exceptions import UnexpectedInput, VisitError

    if text.strip().lower() in ("", "all", "*"):
        return Condition("o.removed = ''")
    try:
        tree = _make_parser().parse(text)
        found = _make_translator().transform(tree)
    except UnexpectedInput as error:
        place = getattr(error, "column", 0) or len(text) + 1
        raise BadParameter(
            f"query: cannot be understood from character {place} on ({text[max(place - 1, 0) :][:30] or 'its end'!r}); "
            "write for example: rate > 100 and has:mag and tag:fast"
        ) from None
    except VisitError as error:
        if isinstance(error.orig_exc, BadParameter):
            raise error.orig_exc from None
        raise
    if "o.removed" in found.sql:
        return Condition(found.sql, found.parameters)
    return Condition(f"({found.sql}) AND o.removed = ''", found.parameters)


@cache
def _make_parser() -> Any:
    from lark import Lark

    return Lark(_GRAMMAR, parser="lalr")


@cache
def _make_translator() -> Any:
    """Return the Lark transformer whose methods turn the rules of the grammar into conditions."""
    from lark import Transformer

    class Translator(Transformer):
        """Turns the tree of a query into one condition."""

        def start(self, parts: list[Condition]) -> Condition:
            return parts[0]

        def alternatives(self, parts: list[Condition]) -> Condition:
            return _join(" OR ", parts)

        def conditions(self, parts: list[Condition]) -> Condition:
            return _join(" AND ", parts)

        def negation(self, parts: list[Condition]) -> Condition:
            return Condition(f"NOT ({parts[0].sql})", parts[0].parameters)

        def comparison(self, parts: list[Any]) -> Condition:
            return _compare_field(_read_field(parts[0]), str(parts[1]), parts[2])

        def label(self, parts: list[Any]) -> Condition:
            return _match_label(_read_field(parts[0]), parts[1])

        def anywhere(self, parts: list[str]) -> Condition:
            word = parts[0]
            tests = " OR ".join(_CONTAINS.format(f"o.{column}") for column in ("name", "file_name"))
            return Condition(f"({tests})", (word, word))

        def value(self, parts: list[Any]) -> str:
            token = parts[0]
            return str(token)[1:-1] if token.type == "QUOTED" else str(token)

    return Translator()


def _read_field(name: Any) -> str:
    """Return a field as it is written, in lower case; a key of metadata keeps its case."""
    head, dot, rest = str(name).partition(".")
    return f"{head.lower()}{dot}{rest}"


def _join(word: str, parts: list[Condition]) -> Condition:
    """Return the conditions in brackets with a word of SQL between them."""
    sql = word.join(f"({part.sql})" for part in parts)
    return Condition(sql, tuple(value for part in parts for value in part.parameters))


def _compare_field(name: str, operator: str, value: str) -> Condition:
    """Return the condition ``name operator value``."""
    head, dot, rest = name.partition(".")
    if head == "meta" and dot:
        return _match_row("metadata", "key", rest, _compare("t.value", operator, value, number=_is_number(value)))
    if head in _OF_STREAMS and dot:
        column = f"t.{_OF_STREAMS[head]}"
        return _match_row(
            "streams", "stream", rest, _compare(column, operator, _parse_number(name, value), number=True)
        )
    if head == "tag":
        return _match_label("tag", value) if operator == "=" else _match_tag(operator, value)
    if name in SCORE_FIGURES:
        test = _compare(f"t.{name}", operator, _parse_number(name, value), number=True)
        return Condition(
            f"EXISTS (SELECT 1 FROM score_rows t WHERE t.sha256 = o.sha256 AND {test.sql})", test.parameters
        )
    if name not in _FIELDS:
        raise BadParameter(f"query: no field {name!r}; {nearest(name, [*_FIELDS, *SCORE_FIGURES])}; or meta.KEY")
    column = _FIELDS[name]
    if column.removeprefix("o.") in NUMBERS:
        return _compare(column, operator, _parse_number(name, value), number=True)
    return _compare(column, operator, value, number=False)


def _match_label(name: str, value: str) -> Condition:
    """Return the condition ``name:value``."""
    if name == "has":
        return Condition("EXISTS (SELECT 1 FROM streams t WHERE t.sha256 = o.sha256 AND t.stream = ?)", (value,))
    if name == "tag":
        return Condition("EXISTS (SELECT 1 FROM tags t WHERE t.sha256 = o.sha256 AND t.tag = ?)", (value,))
    if name == "id":
        return Condition("substr(o.sha256, 1, ?) = ?", (len(value), value.lower()))
    if name == "is" and value == "removed":
        return Condition("o.removed != ''")
    if name == "is" and value == "damaged":
        return Condition("o.problem != ''")
    if name == "is":
        raise BadParameter(f"query: is:{value} is not known; write is:removed or is:damaged")
    if name in _FIELDS or "." in name:
        return _compare_field(name, "=", value)
    raise BadParameter(f"query: no label {name}:; {nearest(name, [*_LABELS, *_FIELDS])}")


def _compare(column: str, operator: str, value: Any, number: bool) -> Condition:
    """Return the condition that a column compares with a value in this way; texts without regard to case."""
    if operator in ("~", "!~"):
        test = _CONTAINS.format(f"coalesce({column}, '')")
        return Condition(test if operator == "~" else f"NOT {test}", (str(value),))
    if number:
        column = f"CAST({column} AS REAL)"
        return Condition(f"{column} {_SQL[operator]} ?", (float(value),))
    return Condition(f"coalesce({column}, '') {_SQL[operator]} ? COLLATE NOCASE", (value,))


def _match_tag(operator: str, value: str) -> Condition:
    """Return the condition that the object has a tag like this."""
    test = _compare("t.tag", operator.removeprefix("!") or operator, value, number=False)
    exists = f"EXISTS (SELECT 1 FROM tags t WHERE t.sha256 = o.sha256 AND {test.sql})"
    return Condition(f"NOT {exists}" if operator.startswith("!") else exists, test.parameters)


def _match_row(table: str, key_column: str, key: str, test: Condition) -> Condition:
    """Return a condition on the row of another table that belongs to the object and has this key."""
    return Condition(
        f"EXISTS (SELECT 1 FROM {table} t WHERE t.sha256 = o.sha256 AND t.{key_column} = ? AND {test.sql})",
        (key, *test.parameters),
    )


def _is_number(value: str) -> bool:
    """Return whether a value reads as a number."""
    try:
        float(value)
    except ValueError:
        return False
    return True


def _parse_number(name: str, value: str) -> float:
    """Return a value as a number; raises :class:`BadParameter` with an example."""
    try:
        return float(value)
    except ValueError:
        raise BadParameter(
            f"query: {name} is a number, and {value!r} is none; write for example {name} > 100"
        ) from None

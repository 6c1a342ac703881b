"""Translate a compiled step, with all that it calls, to C99.

The steps use a small part of Python: numbers, tuples, named tuples, arrays of a fixed shape, branches and counted
loops. Types are inferred from the arguments, as numba does, so each function is translated for the types that it is
called with. An expression becomes the same expression in C, with the same order of operations, so that C in double
precision gives the bits of the compiled step as long as the C compiler does not contract or reassociate.

An array that a function makes lies in the ``storage`` of the function, or of its caller where it is returned.
"""

import ast
import inspect
import re
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import numpy as np

from stillpoint.filters.c.types import (
    BOOL,
    INT,
    NOTHING,
    REAL,
    Array,
    CType,
    Scalar,
    Struct,
    Tuple,
    TypeTable,
    count_reals,
    declare,
    holds_array,
    parts_of,
    select_part,
    type_of,
    write_real,
)

Value = tuple[str, CType]  # an expression in C, and its type

_BINARY: dict[type[ast.operator], str] = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Mod: "%"}
_COMPARE: dict[type[ast.cmpop], str] = {
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
    ast.Eq: "==",
    ast.NotEq: "!=",
}
_WIDTH = 110  # of a line in C
_RENAMED = {"exp": "exp_rotation", "log": "log_rotation"}  # C has these names for numbers
_MATH = {"sqrt": "SQRT", "sin": "SIN", "cos": "COS", "exp": "EXP", "atan2": "ATAN2"}


class _NotTranslated(TypeError):
    """A construct of Python for which there is no translation."""


@dataclass(frozen=True)
class Function:
    """A translated function."""

    name: str
    returns: CType
    storage: int  # how many reals its caller gives it


@dataclass
class Translation:
    """The functions of one filter in C, callees first, and their types."""

    prefix: str
    types: TypeTable
    functions: dict[Any, Function] = field(default_factory=dict)
    bodies: list[str] = field(default_factory=list)

    def add(self, function: Callable[..., Any], kinds: Sequence[CType]) -> Function:
        """Translate a function for these types of its arguments, if that has not been done."""
        key = (function, tuple(kinds))
        if key not in self.functions:
            taken = {made.name for made in self.functions.values()}
            plain = function.__name__.lstrip("_")  # C reserves names that begin with an underscore
            name, k = _RENAMED.get(plain, plain), 2
            while name in taken:
                name, k = f"{function.__name__}_{k}", k + 1
            body = _Body(self, function, kinds)
            self.bodies.append(body.write(name))
            self.functions[key] = Function(name, body.returns, body.storage if holds_array(body.returns) else 0)
        return self.functions[key]


class _Body:
    """One function while it is translated."""

    def __init__(self, whole: Translation, function: Callable[..., Any], kinds: Sequence[CType]) -> None:
        self.whole, self.types, self.globals = whole, whole.types, inspect.unwrap(function).__globals__
        tree = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
        assert isinstance(tree, ast.FunctionDef)
        self.tree = tree
        names = [argument.arg for argument in tree.args.args]
        self.arguments = dict(zip(names, kinds, strict=True))
        self.locals: dict[str, CType] = dict(self.arguments)
        self.read = {n.id for n in ast.walk(tree) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load)}
        self.early: list[str] = []  # declarations of what is first assigned inside a branch or loop
        self.lines: list[str] = []
        self.depth, self.storage, self.temporaries = 1, 0, 0
        self.returns: CType = NOTHING

    def write(self, name: str) -> str:
        """Return the function in C."""
        statements = self.tree.body
        comment = ast.get_docstring(self.tree) or ""
        for statement in statements[1 if comment else 0 :]:
            self.add_statement(statement)
        given = [declare(self.types.name(kind), argument) for argument, kind in self.arguments.items()]
        if self.storage and holds_array(self.returns):
            given.append("sp_real *storage")
        elif self.storage:
            self.early.insert(0, f"    sp_real storage[{self.storage}];")
        text = "\n".join(self.lines)
        unused = [f"    (void){one};" for one in self.arguments if not re.search(rf"(?<![.\w]){one}\b", text)]
        head = declare(f"static {self.types.name(self.returns)}", f"{name}({', '.join(given) or 'void'})")
        first = comment.partition("\n")[0].replace(":func:", "").replace("``", "").replace("`", "")
        return "\n".join([f"/* {first} */", head, "{", *self.early, *unused, *self.lines, "}", ""])

    def emit(self, line: str) -> None:
        """Add a line at the depth of the current block."""
        self.lines.append("    " * self.depth + line)

    # Statements

    def add_statement(self, node: ast.stmt) -> None:
        """Translate one statement."""
        if isinstance(node, ast.Assign):
            self.assign(node.targets[0], node.value)
            for target in node.targets[1:]:
                first = node.targets[0]
                self.assign(target, ast.Name(first.id, ast.Load()) if isinstance(first, ast.Name) else node.value)
        elif isinstance(node, ast.AugAssign):
            place, _ = self.value(node.target, is_target=True)
            self.emit(f"{place} {_BINARY[type(node.op)]}= {self.value(node.value)[0]};")
        elif isinstance(node, ast.Return):
            self.add_return(node)
        elif isinstance(node, ast.If):
            self.add_if(node)
        elif isinstance(node, ast.While):
            self.emit(f"while ({self.strip_parentheses(node.test)}) {{")
            self.add_block(node.body)
            self.emit("}")
        elif isinstance(node, ast.For):
            self.add_for(node)
        elif isinstance(node, ast.Expr):
            self.emit(f"{self.value(node.value)[0]};")
        else:
            raise self.refuse(node)

    def refuse(self, node: ast.AST) -> _NotTranslated:
        """Return the error for a construct without a translation."""
        return _NotTranslated(f"{self.tree.name}: {ast.unparse(node)} has no translation to C")

    def add_block(self, statements: Sequence[ast.stmt]) -> None:
        """Translate the statements of a branch or loop."""
        self.depth += 1
        for statement in statements:
            self.add_statement(statement)
        self.depth -= 1

    def add_return(self, node: ast.Return) -> None:
        """Translate a return."""
        if node.value is None:
            self.emit("return;")
            return
        text, kind = self.value(node.value)
        if not (self.returns == REAL and kind == INT):
            self.returns = kind
        self.emit(f"return {_strip_parentheses(text)};")

    def add_if(self, node: ast.If) -> None:
        """Translate a branch."""
        self.emit(f"if ({self.strip_parentheses(node.test)}) {{")
        self.add_block(node.body)
        rest = node.orelse
        while len(rest) == 1 and isinstance(rest[0], ast.If):
            self.emit(f"}} else if ({self.strip_parentheses(rest[0].test)}) {{")
            self.add_block(rest[0].body)
            rest = rest[0].orelse
        if rest:
            self.emit("} else {")
            self.add_block(rest)
        self.emit("}")

    def add_for(self, node: ast.For) -> None:
        """Translate a loop over a range, or over constants, whose turns are written out."""
        assert isinstance(node.target, ast.Name)
        name, over = node.target.id, node.iter
        self.declare_early(name, INT)
        if isinstance(over, ast.Tuple):
            for each in over.elts:
                self.emit(f"{name} = {self.value(each)[0]};")
                for statement in node.body:
                    self.depth += 1
                    self.add_statement(statement)
                    self.depth -= 1
            return
        if not (isinstance(over, ast.Call) and isinstance(over.func, ast.Name) and over.func.id == "range"):
            raise self.refuse(node)
        bounds = [self.value(bound)[0] for bound in over.args]
        low, high = bounds if len(bounds) == 2 else ("0", bounds[0])
        self.emit(f"for ({name} = {low}; {name} < {high}; {name}++) {{")
        self.add_block(node.body)
        self.emit("}")

    def assign(self, target: ast.expr, value: ast.expr) -> None:
        """Translate an assignment, also of several targets at once."""
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
            self.assign_each(target.elts, value.elts)
        elif isinstance(target, ast.Tuple):
            self.unpack(target.elts, self.parts(value, _names_in(target)))
        else:
            self.store(target, *self.value(value))

    def assign_each(self, targets: Sequence[ast.expr], values: Sequence[ast.expr]) -> None:
        """Assign in order; through temporaries where a later value reads an earlier target."""
        names, reads = [_names_in(target) for target in targets], [_names_in(value) for value in values]
        if not any(names[i] & reads[j] for j in range(len(values)) for i in range(j)):
            for target, value in zip(targets, values, strict=True):
                self.assign(target, value)
            return
        held = [self.hold(*self.value(value)) for value in values]
        for target, (text, kind) in zip(targets, held, strict=True):
            if isinstance(target, ast.Tuple):
                parts = parts_of(kind)
                self.unpack(target.elts, [(select_part(text, kind, k), part) for k, part in enumerate(parts)])
            else:
                self.store(target, text, kind)

    def unpack(self, targets: Sequence[ast.expr], values: Sequence[Value]) -> None:
        """Assign the parts of a value that is held in a variable."""
        assert len(targets) == len(values), self.tree.name
        for target, (text, kind) in zip(targets, values, strict=True):
            if isinstance(target, ast.Tuple):
                parts = parts_of(kind)
                self.unpack(target.elts, [(select_part(text, kind, k), part) for k, part in enumerate(parts)])
            else:
                self.store(target, text, kind)

    def parts(self, node: ast.expr, targets: set[str]) -> list[Value]:
        """Return the parts of a tuple or structure, or of a slice of one, that outlast an assignment to targets."""
        low, high = None, None
        if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Slice):
            low, high = (None if end is None else ast.literal_eval(end) for end in (node.slice.lower, node.slice.upper))
            node = node.value
        text, kind = self.value(node)
        if not re.fullmatch(r"[\w.]+", text) or text.partition(".")[0] in targets:
            text, kind = self.hold(text, kind)
        return [(select_part(text, kind, k), part) for k, part in enumerate(parts_of(kind))][low:high]

    def hold(self, text: str, kind: CType) -> Value:
        """Return a new variable with this value."""
        self.temporaries += 1
        name = f"held{self.temporaries}"
        self.declare_early(name, kind)
        self.emit(f"{name} = {_strip_parentheses(text)};")
        return name, kind

    def store(self, target: ast.expr, text: str, kind: CType) -> None:
        """Assign one value."""
        text = _strip_parentheses(text)
        if not isinstance(target, ast.Name):
            self.emit(f"{self.value(target, is_target=True)[0]} = {text};")
            return
        name = target.id
        if name not in self.read:  # never used
            if "(" in text and not text.startswith("("):
                self.emit(f"(void)({text});")
            return
        if name in self.locals:
            known = self.locals[name]
            if known != kind and not {known, kind} <= {REAL, INT, BOOL}:
                raise _NotTranslated(f"{self.tree.name}: {name} changes its type")
            self.emit(f"{name} = {text};")
        elif self.depth == 1:
            self.locals[name] = kind
            self.emit(f"{declare(self.types.name(kind), name)} = {text};")
        else:
            self.declare_early(name, kind)
            self.emit(f"{name} = {text};")

    def declare_early(self, name: str, kind: CType) -> None:
        """Declare a variable at the top of the function."""
        if name in self.locals:
            return
        self.locals[name] = kind
        zero = "NULL" if isinstance(kind, Array) else "0"
        if isinstance(kind, Tuple | Struct):
            zero = _write_zero(kind)
        self.early.append(f"    {declare(self.types.name(kind), name)} = {zero};")

    # Expressions

    def strip_parentheses(self, node: ast.expr) -> str:
        """Return an expression without the parentheses around it."""
        return _strip_parentheses(self.value(node)[0])

    def value(self, node: ast.expr, is_target: bool = False) -> Value:
        """Return an expression in C and its type."""
        if not is_target and _is_constant_sum(node):
            return self.constant(eval(compile(ast.Expression(node), "constant", "eval"), {}))
        kinds: dict[type[ast.expr], Callable[[Any], Value]] = {
            ast.Name: self.name,
            ast.Attribute: self.attribute,
            ast.Subscript: self.subscript,
            ast.BinOp: self.binary,
            ast.UnaryOp: self.unary,
            ast.BoolOp: self.boolean,
            ast.Compare: self.compare,
            ast.IfExp: self.choice,
            ast.Tuple: self.tuple,
            ast.Call: self.call,
        }
        if type(node) not in kinds:
            raise self.refuse(node)
        return kinds[type(node)](node)

    def constant(self, value: Any) -> Value:
        """Return a constant of Python."""
        kind = type_of(value)
        if isinstance(kind, Tuple):
            return f"({self.types.name(kind)}){self.types.write_value(value)}", kind
        if kind == REAL:
            return write_real(value), kind
        return self.types.write_value(value), kind

    def name(self, node: ast.Name) -> Value:
        """Return a variable, or a constant of the module."""
        if node.id in self.locals:
            return node.id, self.locals[node.id]
        return self.constant(self.globals[node.id])

    def find(self, node: ast.expr) -> Any:
        """Return the Python object that a name or a name in a module stands for."""
        if isinstance(node, ast.Name):
            return None if node.id in self.locals else self.globals.get(node.id, node.id)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            owner = self.find(node.value)
            return getattr(owner, node.attr) if isinstance(owner, ModuleType) else None
        return None

    def attribute(self, node: ast.Attribute) -> Value:
        """Return a field, or a constant of another module."""
        found = self.find(node)
        if found is not None:
            return self.constant(found)
        text, kind = self.value(node.value)
        if isinstance(kind, Array) and node.attr == "itemsize":
            return "(int)sizeof(sp_real)", INT
        if not isinstance(kind, Struct):
            raise self.refuse(node)
        k = kind.names.index(node.attr)
        return f"{text}.{node.attr}", kind.parts[k]

    def subscript(self, node: ast.Subscript) -> Value:
        """Return an entry of an array or a part of a tuple."""
        text, kind = self.value(node.value)
        if isinstance(kind, Array):
            places = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
            at = [self.value(place)[0] for place in places]
            if len(at) == len(kind.shape):
                place = at[0] if len(at) == 1 else f"{at[0]} * {kind.shape[1]} + {at[1]}"
                return f"{text}[{_strip_parentheses(place)}]", REAL
            return f"({text} + {at[0]} * {kind.shape[1]})", Array(kind.shape[1:])
        parts = parts_of(kind)
        place, _ = self.value(node.slice)
        if place.isdigit():
            return select_part(text, kind, int(place)), parts[int(place)]
        if not (isinstance(kind, Tuple) and kind.is_even):
            raise self.refuse(node)
        return f"{text}.v[{place}]", parts[0]

    def binary(self, node: ast.BinOp) -> Value:
        """Return an operation on two numbers; parentheses keep Python's order."""
        (left, kind), (right, other) = self.value(node.left), self.value(node.right)
        result, rank = REAL if REAL in (kind, other) else INT, _rank_of(node)
        left = _strip_parentheses(left) if _rank_of(node.left) >= rank else left
        right = _strip_parentheses(right) if _rank_of(node.right) > rank else right
        if isinstance(node.op, ast.FloorDiv) and result == INT:
            return f"({left} / {right})", INT  # of numbers that are not negative
        if type(node.op) not in _BINARY:
            raise self.refuse(node)
        return f"({left} {_BINARY[type(node.op)]} {right})", result

    def unary(self, node: ast.UnaryOp) -> Value:
        """Return a number with its sign changed, or a negation."""
        text, kind = self.value(node.operand)
        return (f"!{text}", BOOL) if isinstance(node.op, ast.Not) else (f"(-{text})", kind)

    def boolean(self, node: ast.BoolOp) -> Value:
        """Return a conjunction or a disjunction."""
        sign = " && " if isinstance(node.op, ast.And) else " || "
        return f"({sign.join(self.value(part)[0] for part in node.values)})", BOOL

    def compare(self, node: ast.Compare) -> Value:
        """Return a comparison of two numbers."""
        if len(node.ops) != 1 or type(node.ops[0]) not in _COMPARE:
            raise self.refuse(node)
        left, right = self.value(node.left)[0], self.value(node.comparators[0])[0]
        return f"({left} {_COMPARE[type(node.ops[0])]} {right})", BOOL

    def choice(self, node: ast.IfExp) -> Value:
        """Return one of two values."""
        (yes, kind), (no, other) = self.value(node.body), self.value(node.orelse)
        return f"({self.value(node.test)[0]} ? {yes} : {no})", REAL if REAL in (kind, other) else kind

    def tuple(self, node: ast.Tuple) -> Value:
        """Return a tuple."""
        values = [self.value(part) for part in node.elts]
        kind = Tuple(tuple(part for _, part in values))
        name, inner = self.types.name(kind), ", ".join(_strip_parentheses(text) for text, _ in values)
        return (f"({name}){{{{{inner}}}}}" if kind.is_even else f"({name}){{{inner}}}"), kind

    def call(self, node: ast.Call) -> Value:
        """Return a call of a function, or a new named tuple."""
        found = self.find(node.func)
        name = getattr(found, "__name__", found)
        if found is np.zeros_like or found is np.empty_like or self.is_numpy(node.func):
            return self.allocate(node)
        if isinstance(found, type) and hasattr(found, "_fields"):
            return self.build(found, node)
        values = [self.value(argument) for argument in node.args]
        texts = [_strip_parentheses(text) for text, _ in values]
        if isinstance(name, str) and getattr(found, "__module__", "") in ("math", "builtins"):
            found = name
        if isinstance(found, str):
            return self.call_builtin(found, texts, values, node)
        if name == "like":
            return f"(sp_real){values[1][0]}", REAL
        made = self.whole.add(found.py_func, [kind for _, kind in values])
        if made.storage:
            texts.append(self.take_storage(made.storage))
        return f"{made.name}({', '.join(texts)})", made.returns

    def is_numpy(self, node: ast.expr) -> bool:
        """Return whether a call is one of numpy's."""
        return isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "np"

    def take_storage(self, reals: int) -> str:
        """Return the address of so many reals of the function's storage."""
        at = self.storage
        self.storage += reals
        return f"storage + {at}" if at else "storage"

    def allocate(self, node: ast.Call) -> Value:
        """Return a new array."""
        assert isinstance(node.func, ast.Attribute)
        _, kind = self.value(node.args[0])
        if not isinstance(kind, Array) or node.func.attr not in ("zeros_like", "empty_like"):
            raise self.refuse(node)
        reals = count_reals(kind.shape)
        place = self.take_storage(reals)
        return (f"fill_zeros({place}, {reals})" if node.func.attr == "zeros_like" else f"({place})"), kind

    def build(self, made: Any, node: ast.Call) -> Value:
        """Return a new named tuple; what is None in it is left out."""
        values: list[Value] = []
        for argument in node.args:
            if isinstance(argument, ast.Starred):
                text, kind = self.value(argument.value)
                values += [(select_part(text, kind, k), part) for k, part in enumerate(parts_of(kind))]
            elif isinstance(argument, ast.Constant) and argument.value is None:
                values.append(("", NOTHING))
            else:
                values.append(self.value(argument))
        kept = [(name, *value) for name, value in zip(made._fields, values, strict=True) if value[1] != NOTHING]
        kind = self.find_equal_struct(made, Struct(made, tuple(k[0] for k in kept), tuple(k[2] for k in kept)))
        return f"({self.types.name(kind)}){{{', '.join(_strip_parentheses(k[1]) for k in kept)}}}", kind

    def find_equal_struct(self, made: type, kind: Struct) -> Struct:
        """Return the type that this named tuple already has where only numbers differ, int for real."""
        for known in self.types.names:
            if isinstance(known, Struct) and known.of is made and known.names == kind.names:
                same = all(
                    a == b or (isinstance(a, Scalar) and isinstance(b, Scalar))
                    for a, b in zip(known.parts, kind.parts, strict=True)
                )
                if same:
                    return known
        return kind

    def call_builtin(self, name: str, texts: list[str], values: list[Value], node: ast.Call) -> Value:
        """Return a call of a function of Python's own."""
        inner, kinds = ", ".join(texts), [kind for _, kind in values]
        if name in _MATH:
            return f"{_MATH[name]}({inner})", REAL
        if name == "abs" and kinds == [REAL]:
            return f"FABS({inner})", REAL
        if name in ("min", "max") and len(texts) == 2 and REAL in kinds:
            return f"{name}_real({inner})", REAL
        if name == "round" and kinds == [REAL]:
            return f"(int)RINT({inner})", INT
        if name == "len" and isinstance(kinds[0], Array):
            return str(kinds[0].shape[0]), INT
        raise self.refuse(node)


def wrap_lines(text: str) -> str:
    """Break long lines of C between tokens; lines of comments keep their star."""
    wrapped: list[str] = []
    for line in text.split("\n"):
        indent = line[: len(line) - len(line.lstrip())]
        later = indent + ("* " if line.startswith(" * ") else "    ")
        wrapped += textwrap.wrap(
            line, _WIDTH, subsequent_indent=later, break_long_words=False, break_on_hyphens=False
        ) or [""]
    return "\n".join(wrapped)


def _names_in(node: ast.AST) -> set[str]:
    """Return the names in an expression."""
    return {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}


def _is_constant_sum(node: ast.expr) -> bool:
    """Return whether Python computes this expression beforehand: it has no names."""
    allowed = ast.Constant | ast.BinOp | ast.UnaryOp | ast.operator | ast.unaryop
    has_truth = any(isinstance(part, ast.Not) for part in ast.walk(node))
    return not has_truth and all(isinstance(part, allowed) for part in ast.walk(node))


def _rank_of(node: ast.expr) -> int:
    """Return how tightly a binary operation binds: sums 1, products 2; 0 for anything else."""
    if not isinstance(node, ast.BinOp):
        return 0
    return 1 if isinstance(node.op, ast.Add | ast.Sub) else 2


def _strip_parentheses(text: str) -> str:
    """Return an expression without one pair of parentheses around the whole of it."""
    if not (text.startswith("(") and text.endswith(")")):
        return text
    depth = 0
    for k, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if depth == 0:
            return text[1:-1] if k == len(text) - 1 else text
    return text


def _write_zero(kind: CType) -> str:
    """Return the initialiser of zeros with the braces that the type has."""
    if isinstance(kind, Scalar):
        return "0"
    if isinstance(kind, Array):
        return "NULL"
    inner = ", ".join(_write_zero(part) for part in parts_of(kind))
    return f"{{{{{inner}}}}}" if isinstance(kind, Tuple) and kind.is_even else f"{{{inner}}}"

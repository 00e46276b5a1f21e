"""Deliberate one-line bugs, made from a module's syntax tree: what each replaces, where, and by what."""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from dataclasses import dataclass

_BINARY = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
_COMPARED = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
_MEANS = {"min": "max", "max": "min", "sin": "cos", "cos": "sin", "minimum": "maximum", "maximum": "minimum"}
_NOTHING = 1e-100  # what only keeps a division from 0 / 0 may be any such number
_COMMUTING = {"minimum", "maximum", "min", "max", "logical_and", "logical_or", "allclose", "isclose", "add", "multiply"}
_REFUSALS = {"InputError", "OutputError", "PftwinError", "PftwinWarning", "MissingExtraError", "warn"}


@dataclass(frozen=True)
class Mutant:
    """One bug: the text of an expression in the file, and what stands there instead."""

    line: int
    start: int  # characters of the file
    end: int
    before: str
    after: str
    what: str

    def applied(self, text: str) -> str:
        """The file with the bug in it."""
        return text[: self.start] + self.after + text[self.end :]

    def label(self) -> str:
        """For a table and for the list of equivalent mutants: it does not name the line, which moves."""
        return f"{self.before} -> {self.after}"

    def text_of_line(self, text: str) -> str:
        """The code in the line of the file where it begins: a comment may be reworded."""
        return text.splitlines()[self.line - 1].split("  # ")[0].strip()


def mutants(text: str) -> list[Mutant]:
    """All bugs that the operators make of a file's text, in the order of the file."""
    tree = ast.parse(text)
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    lines = text.splitlines(keepends=True)

    def place(line: int, column: int) -> int:
        """Characters up to a line and a column, which `ast` counts in bytes."""
        return starts[line - 1] + len(lines[line - 1].encode()[:column].decode())

    found = []
    for node in _computing(tree):
        for old, new, what in _changes(node):
            assert old.end_lineno is not None
            assert old.end_col_offset is not None
            begin, end = place(old.lineno, old.col_offset), place(old.end_lineno, old.end_col_offset)
            after = f"({ast.unparse(ast.fix_missing_locations(new))})"
            found.append(Mutant(old.lineno, begin, end, " ".join(text[begin:end].split()), after, what))
    return sorted(set(found), key=lambda m: (m.start, m.end, m.after))


def _computing(tree: ast.AST) -> Iterator[ast.AST]:
    """The nodes that compute: no annotations, docstrings, texts of messages, assertions for the type checker."""
    for field, value in ast.iter_fields(tree):
        if field in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST) or isinstance(child, ast.Assert | ast.JoinedStr | ast.Raise | ast.Import):
                continue
            if isinstance(child, ast.Call) and _called(child) in _REFUSALS:
                continue
            if _keeps_from_nothing(child):
                assert isinstance(child, ast.BinOp)
                assert isinstance(child.right, ast.Call)
                yield child
                yield from _computing(child.left)
                yield from _computing(ast.Tuple(child.right.args[:2]))
                continue
            yield child
            yield from _computing(child)


def _keeps_from_nothing(node: ast.AST) -> bool:
    """Whether it is x / where(condition, y, 1.0): the constant only keeps a division from 0 / 0, and may be another."""
    if not (isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div) and isinstance(node.right, ast.Call)):
        return False
    call = node.right
    return _called(call) == "where" and len(call.args) == 3 and isinstance(call.args[2], ast.Constant)


def _called(node: ast.Call) -> str:
    return node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")


def _changes(node: ast.AST) -> Iterator[tuple[ast.expr, ast.expr, str]]:
    """The expressions to be replaced at a node, by what, and what kind of bug that is; nothing at most nodes."""
    if isinstance(node, ast.If) and not any(isinstance(child, ast.Raise) for child in node.body):
        yield node.test, ast.UnaryOp(ast.Not(), copy.deepcopy(node.test)), "condition negated"
    elif isinstance(node, ast.Return) and node.value is not None and not isinstance(node.value, ast.Constant):
        yield node.value, ast.Constant(None), "nothing returned"
    elif isinstance(node, ast.expr):
        yield from ((node, new, what) for new, what in _of_expressions(node))


def _of_expressions(node: ast.expr) -> Iterator[tuple[ast.expr, str]]:
    if isinstance(node, ast.BinOp):
        yield from _of_sums_and_products(node)
    elif isinstance(node, ast.Compare) and type(node.ops[0]) in _COMPARED:
        new = copy.deepcopy(node)
        new.ops[0] = _COMPARED[type(node.ops[0])]()
        yield new, "comparison"
    elif isinstance(node, ast.BoolOp):
        new = copy.deepcopy(node)
        new.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield new, "and for or"
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub | ast.Invert):
        yield copy.deepcopy(node.operand), "sign or not left out"
    elif isinstance(node, ast.Constant) and isinstance(node.value, int) and not isinstance(node.value, bool):
        yield ast.Constant(node.value + 1), "constant"
    elif isinstance(node, ast.Constant) and isinstance(node.value, float) and node.value > _NOTHING:
        yield ast.Constant(1.5 * node.value), "constant"
    elif isinstance(node, ast.Constant) and isinstance(node.value, float) and node.value == 0:
        yield ast.Constant(1.0), "constant"
    elif isinstance(node, ast.IfExp):
        yield ast.IfExp(node.test, copy.deepcopy(node.orelse), copy.deepcopy(node.body)), "branches swapped"
    elif isinstance(node, ast.Call):
        yield from _of_calls(node)


def _of_sums_and_products(node: ast.BinOp) -> Iterator[tuple[ast.expr, str]]:
    if type(node.op) in _BINARY:
        new = copy.deepcopy(node)
        new.op = _BINARY[type(node.op)]()
        yield new, "operator"
        yield copy.deepcopy(node.left), "factor or summand left out"
    elif isinstance(node.op, ast.Pow):
        yield copy.deepcopy(node.left), "power left out"
    elif isinstance(node.op, ast.BitAnd | ast.BitOr):
        new = copy.deepcopy(node)
        new.op = ast.BitOr() if isinstance(node.op, ast.BitAnd) else ast.BitAnd()
        yield new, "and for or"


def _of_calls(node: ast.Call) -> Iterator[tuple[ast.expr, str]]:
    if (
        len(node.args) >= 2
        and all(type(a) is type(node.args[0]) for a in node.args[:2])
        and isinstance(node.args[0], ast.Name | ast.Attribute | ast.Subscript)
        and ast.dump(node.args[0]) != ast.dump(node.args[1])
        and _called(node) not in _COMMUTING
    ):
        new = copy.deepcopy(node)
        new.args[0], new.args[1] = new.args[1], new.args[0]
        yield new, "arguments swapped"
    name = _called(node)
    if name in _MEANS:
        new = copy.deepcopy(node)
        if isinstance(new.func, ast.Attribute):
            new.func.attr = _MEANS[name]
        elif isinstance(new.func, ast.Name):
            new.func.id = _MEANS[name]
        yield new, "another function"
    for i, keyword in enumerate(node.keywords):
        if keyword.arg in ("axis", "ddof"):
            new = copy.deepcopy(node)
            del new.keywords[i]
            yield new, f"{keyword.arg} left out"

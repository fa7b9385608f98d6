"""The source text of kernels, parsed: looked for where Python keeps it, and refused where it is not what is running."""

import __future__

import ast
import linecache
from collections import Counter
from functools import cache
from types import CodeType
from typing import Any, NamedTuple

from .kinds import Refused

_FUTURE = sum({getattr(__future__, name).compiler_flag for name in __future__.all_feature_names} - {0x10})
"""Flags of code that follow from `from __future__ import ...` (0x10 says that a function lies within another)."""


class Source(NamedTuple):
    """A function's tree and what is known of it beforehand."""

    tree: ast.FunctionDef
    file: str
    often: frozenset[str]  # names that are given more than one value
    scope: dict[str, Any]  # global names, and those of the functions around it

    def placed(self, error: Refused, number: int) -> Refused:
        """The refusal with file, line and the line itself."""
        if error.placed:
            return error
        text = linecache.getline(self.file, number).strip()
        made = Refused(f"{self.file}:{number}, in {self.tree.name}: {error}\n    {text}")
        made.placed = True
        return made


@cache
def source_of(function: Any) -> Source:
    """A Python function's source. Refused: there is none, or it has changed since the function was made."""
    code, name = function.__code__, f"{function.__module__}.{function.__qualname__}"
    at = f"{code.co_filename}:{code.co_firstlineno}"
    if code.co_name == "<lambda>":
        raise Refused(f"{at}: a lambda: a kernel is a function with a name of its own")
    if hasattr(function, "__wrapped__"):
        raise Refused(f"{at}: another decorator stands between {function.__name__} and @kernel, the last one")
    lines = linecache.getlines(code.co_filename, function.__globals__)
    if not lines:
        raise Refused(
            f"{name}: its source text cannot be had ({code.co_filename}), and kernels are compiled from their text: "
            "put it into a file or a notebook's cell"
        )
    tree = _tree("".join(lines), code)
    if tree is None:
        raise Refused(
            f"{name}: {code.co_filename} has changed since it was imported: start Python anew, or reload the module"
        )
    if isinstance(tree, ast.AsyncFunctionDef):
        raise Refused(f"{function.__qualname__} is async: no kernel waits")
    given = tree.args
    if given.posonlyargs or given.vararg or given.kwonlyargs or given.kwarg or getattr(tree, "type_params", None):
        raise Refused(f"{at}: {name}({ast.unparse(given)}): a kernel's arguments are names, some with defaults")
    scope = dict(function.__globals__) if code.co_freevars else function.__globals__
    for free, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
        try:
            scope[free] = cell.cell_contents
        except ValueError:
            raise Refused(f"{name}: {free!r} of the function around it has no value yet") from None
    return Source(tree, code.co_filename, frozenset(_often(tree)), scope)


def _tree(text: str, code: CodeType) -> Any:
    """The definition in a file's text that comes to a function's code; None: there is none any more."""
    place, flags = (code.co_name, code.co_firstlineno), code.co_flags & _FUTURE
    try:
        parsed, trees = _parsed(text)
        if place not in trees:
            return None
        tree, statement = trees[place]
        for module in (parsed, ast.Module([statement], [])):  # notebooks compile statement by statement
            made = _codes(module, flags).get(place)
            if made is not None and _meaning(made) == _meaning(code):
                return tree
    except SyntaxError:
        pass
    return None


@cache
def _parsed(text: str) -> tuple[ast.Module, dict[tuple[str, int], tuple[Any, ast.stmt]]]:
    """A file; by name and first line, its functions, each with the statement of the file that it is in."""
    parsed, trees = ast.parse(text), {}
    for statement in parsed.body:
        nodes: list[ast.AST] = [statement]
        for node in nodes:  # and what is found below, but for expressions, which define none
            nodes += [part for part in ast.iter_child_nodes(node) if not isinstance(part, ast.expr)]
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                first = min(part.lineno for part in (node, *node.decorator_list))
                trees[node.name, first] = node, statement
    return parsed, trees


@cache
def _codes(module: ast.Module, flags: int) -> dict[tuple[str, int], CodeType]:
    """Code of the functions of a file, by name and first line."""
    found, left = {}, [compile(module, "", "exec", flags, dont_inherit=True)]
    while left:
        code = left.pop()
        found[code.co_name, code.co_firstlineno] = code
        left += [part for part in code.co_consts if isinstance(part, CodeType)]
    return found


def _meaning(code: CodeType) -> list[Any]:
    """What code does, but for its first string, which describes it."""
    constants = code.co_consts[1:] if code.co_consts and isinstance(code.co_consts[0], str) else code.co_consts
    known = [repr(x) for x in constants if not isinstance(x, CodeType) and x is not None]
    return [code.co_code, code.co_names, code.co_varnames, code.co_freevars, *known]


def _often(tree: ast.FunctionDef) -> set[str]:
    """Names that get a value at more than one place, or at one that is written out several times."""
    found = Counter(argument.arg for argument in tree.args.args)

    def visit(node: ast.AST, times: int) -> None:
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found[node.id] += times
        elif not isinstance(node, ast.expr) or isinstance(node, ast.Tuple | ast.List):
            once = node.target if isinstance(node, ast.For) and not _counts(node.iter) else None
            for part in ast.iter_child_nodes(node):
                again = isinstance(node, ast.AugAssign) or once not in (None, part)
                visit(part, 2 if again else times)

    visit(tree, 1)
    return {name for name, times in found.items() if times > 1}


def _counts(over: ast.expr) -> bool:
    """Whether a loop goes over a range, not over a tuple, for which it is written out."""
    return isinstance(over, ast.Call) and isinstance(over.func, ast.Name)

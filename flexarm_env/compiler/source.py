"""Source text of kernels, read by `linecache` and parsed to an AST; text unlike the running code is refused."""

import __future__

import ast
import contextlib
import linecache
from collections import Counter
from collections.abc import Iterator
from functools import cache
from types import CodeType, ModuleType
from typing import Any, NamedTuple

from .kinds import Refused

_FUTURE = sum({getattr(__future__, name).compiler_flag for name in __future__.all_feature_names} - {0x10})
"""Code flags of `from __future__ import ...`, without 0x10, which marks a nested function."""


class Source(NamedTuple):
    """A kernel's syntax tree (AST), with the information that does not depend on the types of its arguments.

    tree: the function's AST node. file: path of the source file. often: names that are assigned more than once, which
        get stack slots. scope: values of global names and of closure variables, by name.
    """

    tree: ast.FunctionDef
    file: str
    often: frozenset[str]
    scope: dict[str, Any]

    def placed(self, error: Refused, number: int) -> Refused:
        """Return the error with file, line number and text of the line in its message.

        number: number of the line in the source file. An error that already names file and line is returned unchanged.
        """
        if error.placed:
            return error
        text = linecache.getline(self.file, number).strip()
        made = Refused(f"{self.file}:{number}, in {self.tree.name}: {error}\n    {text}")
        made.placed = True
        return made


@cache
def source_of(function: Any) -> Source:
    """Return the `Source` of a Python function, cached.

    Raises a compile error (`Refused`) for lambdas, async functions, other decorators, starred or keyword-only
    arguments, functions without source text, and functions whose source text has changed since Python compiled them.
    """
    code, name = function.__code__, f"{function.__module__}.{function.__qualname__}"
    at = f"{code.co_filename}:{code.co_firstlineno}"
    if code.co_name == "<lambda>":
        raise Refused(f"{at}: a lambda: a kernel is a function with a name of its own")
    if hasattr(function, "__wrapped__"):
        raise Refused(f"{at}: another decorator stands between {function.__name__} and @kernel, the last one")
    # text of the file or notebook cell
    lines = linecache.getlines(code.co_filename, function.__globals__)
    if not lines:
        raise Refused(
            f"{name}: its source text cannot be had ({code.co_filename}), and kernels are compiled from their text: "
            "put it into a file or a notebook's cell"
        )
    # AST of the definition whose bytecode is the running one
    tree = _tree(lines, function)
    if tree is None:
        raise Refused(
            f"{name}: {code.co_filename} has changed since it was imported: start Python anew, or reload the module"
        )
    if isinstance(tree, ast.AsyncFunctionDef):
        raise Refused(f"{function.__qualname__} is async: no kernel waits")
    given = tree.args
    if given.posonlyargs or given.vararg or given.kwonlyargs or given.kwarg or getattr(tree, "type_params", None):
        raise Refused(f"{at}: {name}({ast.unparse(given)}): a kernel's arguments are names, some with defaults")
    # global names, and the values of closure variables as they are now
    scope = dict(function.__globals__) if code.co_freevars else function.__globals__
    for free, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
        try:
            scope[free] = cell.cell_contents
        except ValueError:
            raise Refused(f"{name}: {free!r} of the function around it has no value yet") from None
    return Source(tree, code.co_filename, frozenset(_often(tree)), scope)


def _tree(lines: list[str], function: Any) -> Any:
    """Return the AST node in a file's lines that compiles to a function's code; None if the file has no such node.

    Candidates are found by name and first line; bytecode and constants must match, docstrings may differ.
    """
    code = function.__code__
    place, flags = (code.co_name, code.co_firstlineno), code.co_flags & _FUTURE
    try:
        for module, tree in _candidates(lines, function):
            made = _codes(module, flags).get(place)
            if made is not None and _meaning(made) == _meaning(code):
                return tree
    except SyntaxError:
        pass
    return None


def _candidates(lines: list[str], function: Any) -> Iterator[tuple[ast.Module, Any]]:
    """Yield (AST to compile, function node in it) of possible definitions of a function, the cheapest to parse first.

    The definition's own lines are parsed first, because whole files take longer to parse and to compile: 5 % of a first
    start. The whole file is parsed for functions within functions, and if `_own_lines` misjudges where one ends.
    """
    code = function.__code__
    place, first = (code.co_name, code.co_firstlineno), code.co_firstlineno - 1
    # bytecode of a call math.floor(x) depends on whether the file imports `math`
    modules = [name for name in code.co_names if isinstance(function.__globals__.get(name), ModuleType)]
    imports = f"import {', '.join(modules)}" if modules else ""
    with contextlib.suppress(SyntaxError):
        # empty lines in front keep the line numbers of the file
        alone = ast.parse("\n" * first + "".join((*_own_lines(lines, first), "\n", imports)))
        if alone.body and isinstance(alone.body[0], ast.FunctionDef):
            yield alone, alone.body[0]
    parsed, trees = _parsed("".join(lines))
    if place in trees:
        tree, statement = trees[place]
        # compiled with the whole file, or as one statement, as notebooks do
        yield parsed, tree
        yield ast.Module([statement], []), tree


def _own_lines(lines: list[str], first: int) -> list[str]:
    """Return the lines of a definition at module level that begins in line `first` (from 0), decorators included.

    The definition ends before the first line after "def" that begins with anything but a blank, a comment or ")".
    """
    end = first
    while end < len(lines) and not lines[end].startswith("def "):
        end += 1
    end += 1
    while end < len(lines) and lines[end][0] in " \t\r\n\f#)":
        end += 1
    return lines[first:end]


@cache
def _parsed(text: str) -> tuple[ast.Module, dict[tuple[str, int], tuple[Any, ast.stmt]]]:
    """Parse a file; return its AST, and by (name, first line) each function's node with its top-level statement."""
    parsed, trees = ast.parse(text), {}
    for statement in parsed.body:
        nodes: list[ast.AST] = [statement]
        # breadth-first over statements; expressions define no functions
        for node in nodes:
            nodes += [part for part in ast.iter_child_nodes(node) if not isinstance(part, ast.expr)]
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                # Python's first line of a function is that of its first decorator
                first = min(part.lineno for part in (node, *node.decorator_list))
                trees[node.name, first] = node, statement
    return parsed, trees


@cache
def _codes(module: ast.Module, flags: int) -> dict[tuple[str, int], CodeType]:
    """Compile a module and return the code objects of all its functions, nested ones too, by (name, first line)."""
    found, left = {}, [compile(module, "", "exec", flags, dont_inherit=True)]
    while left:
        code = left.pop()
        found[code.co_name, code.co_firstlineno] = code
        left += [part for part in code.co_consts if isinstance(part, CodeType)]
    return found


def _meaning(code: CodeType) -> list[Any]:
    """Return bytecode, names and constants of a code object, without its docstring, for comparison."""
    constants = code.co_consts[1:] if code.co_consts and isinstance(code.co_consts[0], str) else code.co_consts
    # by repr: 0.0 and -0.0, 1 and True are equal, but not the same
    known = [repr(x) for x in constants if not isinstance(x, CodeType) and x is not None]
    return [code.co_code, code.co_names, code.co_varnames, code.co_freevars, *known]


def _often(tree: ast.FunctionDef) -> set[str]:
    """Return the names of a function that are assigned more than once.

    An assignment in a loop over a tuple counts twice, because the loop is unrolled. An augmented assignment (x += 1)
    also counts twice.
    """
    found = Counter(argument.arg for argument in tree.args.args)

    def visit(node: ast.AST, times: int) -> None:
        """Count the assignments below an AST node, each `times` times."""
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found[node.id] += times
        elif not isinstance(node, ast.expr) or isinstance(node, ast.Tuple | ast.List):
            once = node.target if isinstance(node, ast.For) and not _counts(node.iter) else None
            for part in ast.iter_child_nodes(node):
                # unrolled loop bodies and augmented assignments count twice
                again = isinstance(node, ast.AugAssign) or once not in (None, part)
                visit(part, 2 if again else times)

    visit(tree, 1)
    return {name for name, times in found.items() if times > 1}


def _counts(over: ast.expr) -> bool:
    """Return whether a loop is over a call, range(...), and not over a tuple, for which it is unrolled."""
    return isinstance(over, ast.Call) and isinstance(over.func, ast.Name)

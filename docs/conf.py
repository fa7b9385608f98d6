"""The documentation site: `make docs` builds it, and a warning is an error."""

import inspect
import json
import re
import sys
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.parsers.rst import directives
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import flexarm_env
from flexarm_env.view.page import frame, page

project = "flexarm_env"
author = "flexarm_env contributors"
copyright = author
version = release = flexarm_env.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",  # formulas need no network
    "sphinx.ext.viewcode",
]
exclude_patterns = ["_build"]
suppress_warnings = ["config.cache"]

# ------------------------------------------------------------------- pages
html_theme = "furo"
html_title = f"flexarm_env {version}"
html_copy_source = False
html_static_path = ["_static"]
html_css_files = ["site.css"]

# ---------------------------------------------------------------- Markdown
myst_enable_extensions = ["amsmath", "attrs_block", "deflist", "dollarmath"]
myst_heading_anchors = 3
# `\tag` numbers the equations, as docstrings cite them: MathJax alone is to number
math_number_all = False
mathjax3_config = {"tex": {"tags": "none"}}

# -------------------------------------------------------------- docstrings
default_role = "code"
autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints = "signature"
autodoc_mock_imports = ["matplotlib", "minari", "pygame", "stable_baselines3", "torch"]
autodoc_preserve_defaults = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True


_SIGNS: tuple[tuple[str, Any], ...] = (
    (r"\+-", "±"),
    (r"\^2", "²"),
    (r"\bpi\b", "π"),
    (r"\bsqrt\(", "√("),
    (r"\btau(?=[ _/,)]|$)", "τ"),
    (r"\bw(?=[_²]| =| \||$)|(?<=0\.3 )w\b|(?<=strip` )w\b", "ω"),
    (r"(?<=[a-zωτ])_([0-9])(?![0-9a-z])", lambda found: "₀₁₂₃₄₅₆₇₈₉"[int(found.group(1))]),
    (r"(?<=[a-zA-Zωτ])_k(?![a-zA-Z0-9_])", "ₖ"),
    (r"(?<=[(|=] )-(?=[a-z0-9(])|(?<=\()-(?=[a-z0-9(])|(?<= )-(?=[0-9π])|(?<=[)²] )-(?= [\w(])", "−"),
)
"""Signs of formulas that docstrings, which keep to ASCII, spell out."""


def signs(text: str) -> str:
    """A docstring's text with its formulas as they are printed; what stands in backquotes is code and stays."""
    parts = text.split("`")
    for spelt, sign in _SIGNS:
        parts[::2] = [re.sub(spelt, sign, part) for part in parts[::2]]
    return "`".join(parts)


class Specification(SphinxDirective):
    """`{specification} module.Class`: the class's docstring, which is Markdown, as part of the page."""

    required_arguments = 1
    has_content = False

    def run(self) -> list[nodes.Node]:
        """The nodes of the docstring."""
        module, _, name = self.arguments[0].rpartition(".")
        text = inspect.cleandoc(getattr(import_module(module), name).__doc__ or "")
        text = signs(text)
        text = re.sub(r":class:`~?([\w.]+)`", lambda m: f"`{m.group(1).rpartition('.')[2]}`", text)
        box = nodes.container()
        self.state.nested_parse(StringList(text.splitlines(), source=self.arguments[0]), 0, box, match_titles=True)
        return list(box.children)


class PlayerFrame(SphinxDirective):
    """`{player} NAME`: a player of docs/players/NAME.json, in a frame that is loaded when it is scrolled to; with
    `:folded:` when it is unfolded."""

    required_arguments = 1
    option_spec = {"folded": directives.flag}  # noqa: RUF012
    has_content = False

    def run(self) -> list[nodes.Node]:
        """The frame, and a link to the page alone."""
        name = self.arguments[0]
        data = Path(__file__).parent / "players" / f"{name}.json"
        text = data.read_text("utf-8").strip()
        self.env.note_dependency(str(data))
        title = json.loads(text)["title"]
        path = Path(self.env.app.outdir) / "players" / f"{name}.html"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(page(text, title), encoding="utf-8")
        there = "../" * self.env.docname.count("/") + f"players/{name}.html"
        link = f'<p><a href="{there}">The player alone</a>, in a larger window</p>'
        text = f'<div class="player-frame">{frame(f"""src="{there}" """.strip(), title)}</div>{link}'
        if "folded" in self.options:
            text = f'<details class="player"><summary>{title}</summary>{text}</details>'
        return [nodes.raw("", text, format="html")]


# Docstrings are written to be read in the code: several `name: text` on a line, shapes behind names. Napoleon wants one
# entry a line, and takes what stands before a colon in the first line of a property for its type.
_SECTION = re.compile(r"^(\s*)(Args|Attributes|Raises):\s*(\S.*)?$")
_NAMES = r"\w+(?: \([^)]*\))?(?:, \w+(?: \([^)]*\))?)*"
_ENTRY = re.compile(rf"(?:^|(?<=[.;)]) )({_NAMES}): ")


def entries(text: str, known: set[str]) -> list[str]:
    """The entries of a section, each with its text, from its words in one line; what names nothing is left together."""
    starts = []
    for found in _ENTRY.finditer(text):
        names = re.findall(r"(\w+)(?: \([^)]*\))?(?:, |$)", found.group(1))
        if found.start() == 0 or set(names) <= known or names[0].endswith(("Error", "Equilibrium", "NotInstalled")):
            starts.append(found.start(1))
    cuts = [0, *starts, len(text)] if starts and starts[0] > 0 else [*(starts or [0]), len(text)]
    parts = [text[a:b].strip() for a, b in pairwise(cuts) if text[a:b].strip()]
    return [re.sub(r"(?<=: )(\w)\.$", r"\1", part) for part in parts]  # "s." alone would begin a list


def known_names(item: Any) -> set[str]:
    """Parameters of a function or class, and fields of a class."""
    names = {*getattr(item, "__annotations__", {}), *vars(item)} if inspect.isclass(item) else set()
    try:
        return names | set(inspect.signature(item).parameters)
    except (TypeError, ValueError):
        return names


def tidy(app: Sphinx, what: str, name: str, item: Any, options: Any, lines: list[str]) -> None:
    """One entry a line in Args and Attributes; no substitutions; no type in a property's first line."""
    out: list[str] = []
    k = 0
    while k < len(lines):
        found = _SECTION.match(lines[k])
        k += 1
        if found is None:
            out.append(lines[k - 1])
            continue
        indent, words = found.group(1), [found.group(3) or ""]
        while k < len(lines) and (not lines[k].strip() or lines[k].startswith(indent + " ")):
            if lines[k].strip():
                words.append(lines[k].strip())
            k += 1
        parts = entries(" ".join(words).strip(), known_names(item) | _line_starts(words))
        plain = [part for part in parts if not _ENTRY.match(part)]
        out += [line for part in plain for line in (f"{indent}{part}", "")]
        out.append(f"{indent}{found.group(2)}:")
        parts = [part for part in parts if part not in plain]
        if found.group(2) == "Attributes":
            parts = [one for part in parts for one in _each(part)]
        out += [f"{indent}    {part}" for part in parts]
        out.append("")
    if what == "module":
        out = _literal(out)
    if what in ("property", "attribute", "data") and out:
        out[0] = re.sub(r"(?<!:):(?!:) ", " \N{EN DASH} ", out[0], count=1)
    lines[:] = [line.replace("|", "\\|") if "`" not in line else line for line in out]


_SPELT = {
    r"<factory>": "...",
    r"(?<![\w.~])~?(?!flexarm_env)(?:[a-z_]\w*\.)+(\w+)": r"\1",
    r"TypeAliasForwardRef\('(\w+)'\)": r"\1",
    r"_Buffer \| _SupportsArray.*?\| complex \| bytes \| str \| _NestedSequence\[[^\]]*\]": "ArrayLike",
    r"ndarray\[(?:tuple\[Any, \.\.\.\]|Any), dtype\[(\w+)\]\]": r"NDArray[\1]",
    r"NDArray\[float64\]": "Array",
}


def spell(app: Sphinx, what: str, name: str, item: Any, options: Any, signature: str, returned: str) -> Any:
    """Types of a signature as the code writes them."""
    for long, short in _SPELT.items():
        signature, returned = (text and re.sub(long, short, text) for text in (signature, returned))
    return signature, returned


def _line_starts(lines: list[str]) -> set[str]:
    found = [re.match(rf"({_NAMES}): ", line) for line in lines]
    return {name for one in found if one for name in re.findall(r"(\w+)(?: \([^)]*\))?(?:, |$)", one.group(1))}


def _each(part: str) -> list[str]:
    """`a (n,), b: text` as two entries; a shape holds for the names before it that have none."""
    names, _, text = part.partition(": ")
    shape, out = "", []
    for name, own in reversed(re.findall(r"(\w+)((?: \([^)]*\))?)(?:, |$)", names)):
        shape = own or shape
        out.append(f"{name}{shape}: {text}")
    return out[::-1]


def _literal(lines: list[str]) -> list[str]:
    """Blocks that stand indented after a blank line are code."""
    out: list[str] = []
    for k, line in enumerate(lines):
        begins = k > 0 and line.startswith("    ") and not lines[k - 1].strip()
        if begins and (not out or not any(one.startswith("    ") for one in out[-2:-1])):
            out += ["::", ""]
        out.append(line)
    return out


def keep_tags(app: Sphinx, tree: nodes.document) -> None:
    """Numbered equations as they stand: Sphinx would put them into `split`, where a `\\tag` is not allowed."""
    for node in tree.findall(nodes.math_block):
        if "\\tag" in node.astext():
            node["no-wrap"] = node["nowrap"] = True
            node.children = [nodes.Text(f"\\[{node.astext()}\\]")]


def reach(app: Sphinx, name: str, template: str, context: dict[str, Any], tree: Any) -> None:
    """What the theme leaves out: headings of the navigation have a level, and code that scrolls takes the keyboard."""
    caption = '<p class="caption" role="heading">'
    context["furo_navigation_tree"] = context.get("furo_navigation_tree", "").replace(
        caption, caption.replace(">", ' aria-level="2">')
    )
    if "body" in context:
        context["body"] = context["body"].replace("<pre>", '<pre tabindex="0">')


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", tidy, priority=100)
    app.connect("autodoc-process-signature", spell)
    app.connect("doctree-read", keep_tags)
    app.connect("html-page-context", reach, priority=900)
    app.add_directive("specification", Specification)
    app.add_directive("player", PlayerFrame)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

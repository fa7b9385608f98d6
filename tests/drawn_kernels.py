"""Kernels drawn at random from the language (docs: the compiler), as text that Python and the compiler both take.

What is drawn is defined in both: denominators are not 0, whole numbers stay within 64 bits, indices lie within
arrays, what becomes a whole number is finite. A name keeps its type.
"""

import re
from random import Random

LENGTH = 6
"""Of the arrays a (float64) and m (int64); g is (3, 4) of float64; w (int64) hears in which order things happen."""

HEAD = '''
import math
from typing import NamedTuple

import numpy as np

from flexarm_env.compiler import noinline, kernel, superword


class Pair(NamedTuple):
    x: float
    n: int = 3


TABLE = (0.5, -0.0, 3.0, -1.25)
MIRROR = (0.5, 0.0, 3.0, -1.25)
WHOLE = (5, -3, 2)
GRID = np.array([[1.0, -2.0], [0.0, -0.0], [4.0, 1e300]])


@kernel
def heard(w, v):
    """Whether v is positive; w remembers that it was asked for."""
    w[0] = (w[0] * 31 + v) % 1000003
    return v > 0


@kernel
def scaled(x, y=1.5, n=3):
    return x * y, n - 1


@kernel
def paired(x, n):
    return Pair(x, n) if n > 0 else Pair(x * 0.5)


@kernel
def added(x, c=None):
    if c is None:
        return x
    return x + c


@noinline
def fresh(a, a0, m, m0, g, g0):
    for k in range(len(a)):
        a[k] = a0[k]
        m[k] = m0[k]
    for k in range(g.shape[0]):
        for h in range(g.shape[1]):
            g[k, h] = g0[k, h]


@noinline
def kept(a, m, g, w, floats, wholes):
    for k in range(len(a)):
        floats[1 + k] = a[k]
        wholes[1 + k] = m[k]
    for k in range(g.shape[0]):
        row = g[k]
        for h in range(len(row)):
            floats[7 + k * 4 + h] = row[h]
    wholes[0] = w[0]
'''

FLOATS, WHOLES = 1 + LENGTH + 12, 1 + LENGTH
"""Numbers that are kept of each kernel."""

SIGN = "{< <= > >= == !=}"
RULES = {
    "F": """
        n; n; {0.0 -0.0 1.0 -1.5 0.1 3.0 1e300 5e-324 math.inf -math.inf math.nan}; a[{A1}]; GRID[{0 1 2}, {0 1}]
        5 ({F} {+ - *} {F})
        3 ({F} {/ / // %} n if n != 0.0 else {F})
        {min max}({F}, {F}); {min max}({F}, {F}, {F0}); ({F} if {B} else {F})
        {abs - math.tanh}({F}); math.sqrt(abs({F})); math.atan2({F}, {F}); math.exp(min(10.0, {F}))
        ({math.sin math.cos}(n) if math.isfinite(n) else {F})
        float({W}); ({F} * {W}); g[{W0} % 3, {W0} % 4]; {TABLE MIRROR}[{W} % 4]
        added({F}); added({F}, {F}); added({F}, c={F}); added({F}, None); added(c={F}, x={F})
        scaled({F})[0]; scaled({F}, n={W1})[0]; scaled(*({F}, {F}))[0]
        paired({F}, {W1}).x; Pair({F}).x; paired({F}, {W1})[0]
        2 p.x
        2 last({F}, {F}, {W0}, {W0}, a, m, g, w)""",
    "W": """
        i; i; {(-9) (-2) (-1) 0 1 2 3 5 8}; m[{0 1 2 3 4}]; len(a)
        4 ({W} {+ -} {W})
        2 ({W} * {W})
        2 ({W} {// %} i if i != 0 else {W})
        ({W} {// %} {7 (-7) (-1)}); ({W} {& | ^} {W}); ({W} << {W} % 8); ({W} * 2 ** ({W} % 8))
        ({W} >> {W} % 70); {- ~ abs}({W}); {min max}({W}, {W}); ({W} if {B} else {W})
        ({int math.floor math.ceil}(n) if abs(n) < 1e6 else {W}); WHOLE[{W} % 3]; scaled(n, n={W})[1]
        paired(n, {W}).n; int({B0}); math.floor({W})""",
    "B": f"""
        ({{F0}} {SIGN} {{F0}}); ({{F0}} {SIGN} {{F0}}); b
        3 ({{F0}} {SIGN} {{F0}})
        2 ({{W}} {SIGN} {{W}})
        3 ({{B}} {{and or}} {{B}})
        (not {{B}}); ({{F}} {{< <=}} {{F0}} {SIGN} {{F}}); heard(w, {{W}} % 19 - 9)
        ({{True False}} is not None {{and or}} {{B}}); (None is None {{and or}} {{B}}); (1 < 2 {{and or}} {{B}})""",
    "A": f"{{W0}} % {{{LENGTH} len(a)}}; {{W1}} % {{{LENGTH} len(a)}}\n{{W1}} % {{{LENGTH} len(a)}}",
}
"""What numbers, whole numbers, truth values and places of a may be: what holds nothing deeper in the first line, then
the rest, some of it several times. {F}: another number; {F0}: one that holds nothing deeper; {a b}: one of these words;
n, i, b, p: a name of a number, a whole number, a truth value, a pair; last: the kernel before. Whole numbers stay below
2^53: names hold less than 5000, and nothing lies deeper than twice."""


class Draw:
    """One module of kernels."""

    def __init__(self, seed: int, count: int) -> None:
        self.random, self.count = Random(seed), count
        self.rules: dict[str, list[list[str]]] = {}
        for letter, text in RULES.items():
            first, _, rest = text.strip().partition("\n")
            inner: list[str] = []
            for line in rest.splitlines():
                times, found = re.match(r" *(\d*) ?(.*)", line).groups()  # type: ignore[union-attr]
                inner += found.split("; ") if not times else [found] * int(times)
            self.rules[letter] = [first.split("; "), inner]

    def text(self) -> str:
        """The module's source: kernels drawn0, drawn1, ..., and `main`, which calls each and keeps what it leaves."""
        parts = [HEAD, *(self.kernel(k) for k in range(self.count))]
        parts.append("\n\n@kernel\ndef main(x, y, i, j, a, a0, m, m0, g, g0, w, floats, wholes):\n")
        for k in range(self.count):
            parts.append(f"    fresh(a, a0, m, m0, g, g0)\n    floats[{k}, 0] = drawn{k}(x, y, i, j, a, m, g, w)\n")
            parts.append(f"    kept(a, m, g, w, floats[{k}], wholes[{k}])\n")
        return "".join(parts)

    def kernel(self, number: int) -> str:
        self.serial, self.size, self.lines = 0, 0, list[str]()
        self.last = f"drawn{number - 1}" if number else ""
        self.known: dict[str, str] = {"x": "n", "y": "n", "i": "i", "j": "i"}
        self.fixed: set[str] = set()
        self.block(1, self.random.randint(2, 5), False)
        self.say(1, "return {F2}")
        body = "\n".join(self.lines)
        word = "superword" if number % 2 else "noinline"
        return f"\n\n@{word}\ndef drawn{number}(x, y, i, j, a, m, g, w):\n{body}\n"

    def one(self, *choices: str) -> str:
        return self.random.choice(choices)

    def names(self, letter: str, free: bool = False) -> list[str]:
        """Names of a kind; free: those that may get another value."""
        return [name for name, kind in self.known.items() if kind == letter and not (free and name in self.fixed)]

    def fresh(self, letter: str) -> str:
        """A new name."""
        self.serial += 1
        return f"{letter}{self.serial}"

    # --- expressions ---------------------------------------------------------------------------------
    def draw(self, letter: str, depth: int) -> str:
        """By one of the rules that names are known for."""
        rules = self.rules[letter][depth > 0 and self.random.random() > 0.25]
        while True:
            rule = self.one(*rules)
            if re.search(r"\blast\b", rule):
                if not self.last or self.size >= 4:
                    continue
                rule, self.last = rule.replace("last", self.last), ""
            words = {word: self.names(word) for word in re.findall(r"\b[nibp]\b(?!=)", re.sub(r"\.n\b", "", rule))}
            if all(words.values()):
                break
        for word, names in words.items():
            rule = re.sub(rf"(?<!\.)\b{word}\b(?!=)", self.one(*names), rule)
        return self.filled(rule, depth - 1)

    def filled(self, text: str, depth: int = 2) -> str:
        """A text with what its braces stand for."""

        def found(match: re.Match[str]) -> str:
            word = match[1]
            if word[:1] in RULES and len(word) < 3 and " " not in word:
                return self.draw(word[0], int(word[1:] or max(depth, 0)))
            return self.one(*word.split())

        return re.sub(r"\{([^{}]*)\}", found, text)

    # --- statements ----------------------------------------------------------------------------------
    def say(self, indent: int, line: str) -> None:
        self.lines.append("    " * indent + self.filled(line))

    def block(self, indent: int, count: int, looped: bool) -> None:
        """Statements; names that they bring are known within them alone."""
        before = dict(self.known)
        for _ in range(count):
            self.statement(indent, looped)
        if indent > 1:
            self.known = before

    def statement(self, indent: int, looped: bool) -> None:
        self.size += 1
        nested = indent < 4 and self.size < 9
        way = self.random.randrange(17)
        if way < 2:
            self.write(indent)
        elif way == 2:
            self.say(indent, f"{self.one(*self.names('n', True))} {{+= -= *=}} {{F}}")
        elif way == 3 and self.names("i", True):
            name = self.one(*self.names("i", True))
            self.say(indent, f"{name} {{+= ^= -=}} {{W1}}")
            self.say(indent, f"{name} %= {{4001 (-4001) 97}}")
        elif way == 4:
            self.say(indent, "heard(w, {W} % 100)")
        elif (way == 5 and looped) or (way == 6 and indent > 1):
            self.say(indent, "if {B1}:")
            self.say(indent + 1, "{break continue}" if way == 5 else "return {F1}")
        elif way < 9 and nested:
            for k, head in enumerate(("if {B}:", "elif {B1}:", "else:")):
                if k == 0 or self.random.random() < 0.4:
                    self.say(indent, head)
                    self.block(indent + 1, self.random.randint(1, 2 + (k == 0)), looped)
        elif way < 13 and nested:
            self.loop(indent)
        else:
            self.bind(indent)

    def bind(self, indent: int) -> None:
        """Give a name a value, a new one or one that has one."""
        letter = self.one("n", "n", "i", "b", "p", "two")
        if letter == "two":
            one, two = self.fresh("n"), self.fresh("i")
            other = self.one("scaled({F1}, {F1}, i % 50)", "({F}, {W1} % 4001)", "Pair({F1}, n=j % 9)")
            self.say(indent, f"{one}, {two} = {other}")
            self.known |= {one: "n", two: "i"}
            return
        old = self.names(letter, True)
        name = self.one(*old) if old and self.random.random() < 0.5 else self.fresh(letter)
        made = {"n": "{F}", "i": "{W} % {4001 (-4001) 11}", "b": "{B}", "p": "{Pair paired}({F}, {W1} % 99)"}
        self.say(indent, f"{name} = {made[letter]}")
        self.known[name] = letter

    def write(self, indent: int) -> None:
        """Give an element of an array a value."""
        new, k = self.fresh("r"), self.fresh("k")
        lines = {
            0: ["a[{A1}] {= += *=} {F}"],
            1: ["m[{A1}] = {W} % 4001"],
            2: ["g[{W1} % 3, {W1} % 4] {= -=} {F}"],
            3: [f"{new} = g[{{W1}} % 3]", f"{new}[{{W1}} % len({new})] = {{F}}"],
            4: [f"{new} = a[{{1: :3 1:4 i%6: :j%9 i%6:j%9 :}}]", f"for {k} in range(len({new})):",
                f"    {new}[{k}] += {{F1}}"],
        }  # fmt: skip
        for line in lines[self.random.randrange(5)]:
            self.say(indent, line)

    def loop(self, indent: int) -> None:
        k, q, outer, fixed = self.fresh("i"), self.fresh("n"), dict(self.known), set(self.fixed)
        way = self.random.randrange(6)
        if way < 3:
            over = self.one(
                "{W1} % 5", "{W1} % 5 - 3, {W1} % 5", "{W1} % 5, {W1} % 5 - 4, -1", "{W1} % 5, -3, -2", "3",
                "{W1} % 5 - 2, {W1} % 5, ({1 2 3} if {B1} else {-1 -2 -3})",
            )  # fmt: skip
            self.say(indent, f"for {k} in range({over}):")
        elif way == 3:
            self.say(indent, f"for {k} in ({{W1}} % 50, 3, {{W0}} % 7):")
        elif way == 4:
            self.say(indent, f"for {q}, {k} in (({{F1}}, 1), ({{F1}}, {{W0}} % 7)):")
            self.known[q] = "n"
        else:
            self.say(indent, f"{k} = {{0 1 2 3 4}}")
            self.fixed.add(k)
            self.say(indent, self.one(f"while {k} > 0:", f"while 0 < {k} < 9:", "while True:"))
            for line in (f"    {k} -= 1", f"    if {k} < 0:", "        break"):
                self.say(indent, line)
        self.known[k] = "i"
        self.block(indent + 1, self.random.randint(1, 3), True)
        self.known, self.fixed = outer, fixed

"""The builder that remembers: each instruction on numbers, and how cotangents go back through it.

A `Tape` writes instructions as any builder does. While it records it notes of each one that depends on what derivatives
are taken by what it was made of, in order, in the `Region` that it stands in: a function, the body of a loop, one side
of a branch. `sweep` writes the way back through a region. Memory has cotangents beside it: what is stored takes those
of its place, which are then 0; what is loaded adds to them. On the way back a value of the way forth is asked for by
`back`: in the same stretch of code it is at hand; whole numbers, addresses and what is loaded from arrays that nobody
writes to are found again; all others were kept.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir

from .kinds import Refused
from .rooms import Rooms
from .symbols import DOUBLE, SLOT, Value

Pull = tuple[Any, Callable[[Any], Any]]

_FLAT = ("floor", "ceil", "rint", "fptosi")
_AGAIN = {
    "add", "sub", "mul", "sdiv", "srem", "udiv", "urem", "and", "or", "xor", "shl", "ashr", "lshr", "icmp", "zext",
    "sext", "trunc", "inttoptr", "ptrtoint", "bitcast", "getelementptr", "insertelement", "shufflevector",
    "fadd", "fsub", "fmul", "fneg", "fcmp", "select",
}  # fmt: skip


class Node:
    """A number that depends on what derivatives are taken by: how its cotangent goes back."""

    def __init__(self, value: Any, pulls: list[Pull], region: Any) -> None:
        self.value, self.pulls, self.region = value, pulls, region
        self.cotangent: Any = None
        self.total: Any = None  # where cotangents from other regions are summed


class Region:
    """A stretch of code that is gone through as a whole. kept: what of its values the way back has at hand."""

    entry: Any  # where the way back begins, in which values are found again

    def __init__(self, tape: Tape, code: Any, first: Any) -> None:
        self.tape, self._code, self._begin = tape, code, len(code.blocks)
        self.items: list[Any] = []
        self.kept: dict[int, Any] = {}
        self._outer, tape.region = tape.region, self
        tape.home[id(first)] = self

    def close(self) -> None:
        """What was written since it began is its own, but for what belongs to another."""
        for block in self._code.blocks[self._begin :]:
            self.tape.home.setdefault(id(block), self)
        self.tape.region = self._outer

    def again(self, value: Any) -> Any:
        """A value of its, on the way back."""
        if id(value) not in self.kept:
            found = self.tape.copied(value, self.entry) if self.tape.found_again(value) else self.brought(value)
            self.kept[id(value)] = found
        return self.kept[id(value)]

    def brought(self, value: Any) -> Any:
        """A value that was kept."""
        raise NotImplementedError


def _is_number(kind: Any) -> bool:
    return kind == DOUBLE or (isinstance(kind, ir.VectorType) and kind.element == DOUBLE)


def _all(kind: Any, x: float = -0.0) -> Any:
    """x in all lanes; -0 added to a number leaves it as it is, to the last bit."""
    return ir.Constant(kind, x if kind == DOUBLE else [x] * kind.count)


class Tape(Rooms):
    """See above; it goes on where the writer's builder is."""

    def __init__(self, writer: Any, wide: dict[Any, Any]) -> None:
        super().__init__(writer)
        self.wide = wide
        self.nodes: dict[int, Node] = {}
        self.home: dict[int, Region] = {}
        self._bars: dict[int, Any] = {}
        self._own: set[int] = set()  # arrays whose cotangents begin with 0 where they are stored
        self._changed: set[int] = set()  # arrays that are stored to
        self._stores: dict[int, list[Any]] = {}  # of numbers that have cotangents, by where they go
        self._dear: set[int] = set()  # what costs too much to be found again
        self._asked: list[Any] = []  # by the way back
        self._copied: list[tuple[Any, Any, Any]] = []
        self._taken: list[Any] = []
        self._alive: list[Any] = []
        self._first = writer.b.block
        self.recording = False
        self.region: Any = None
        self._forth = self._code.append_basic_block("forth")

    # --- the whole ---------------------------------------------------------------------------------
    def argument(self, array: Any, bar: Any) -> Any:
        """The address of an array in place of which a copy is worked on where it is written to; bar: its cotangents, or
        None: room of its own."""
        slot = self.slot(DOUBLE.as_pointer())
        size = array.shape[0]
        for more in array.shape[1:]:
            size = self.mul(size, more)
        if bar is None:
            cotangents = self.taken(size)
            self._taken.append(cotangents)
        else:
            bar.written()
            cotangents = bar.data
        with self.at(self._forth):
            data = self.load(slot)
        self._copied.append((slot, data, (array.data, size, bar is None)))
        self.paired(data, cotangents, own=bar is None)
        return data

    def begin(self) -> None:
        """The way forth."""
        self._first = self.block
        self.position_at_end(self._forth)
        self._begin = len(self._code.blocks)
        self.region = self.whole = Region(self, self._code, self._forth)  # whose values are at hand on the way back
        del self.home[id(self._forth)]
        self.recording = True

    def finish(self) -> None:
        """The way back, and what was taken is given back."""
        self.recording, self._end = False, len(self._code.blocks)
        back = self._code.append_basic_block("back")
        self.branch(back)
        self.position_at_end(back)
        self.sweep(self.whole)
        for room in self._taken:
            self.given_back(room)
        end = self.block
        self._leave_out()
        self.position_at_end(self._first)
        copies = []
        for slot, data, (source, size, free) in self._copied:
            if id(data) in self._changed and not free:
                source = self.copied_room(source, size)
                copies.append(source)
            self.store(source, slot)
        self.branch(self._forth)
        self.position_at_end(end)
        for copy in copies:
            self.given_back(copy)

    def _leave_out(self) -> None:
        """What is stored on the way forth and read by nothing that the way back asks for."""
        blocks = [self._forth, *self._code.blocks[self._begin :]]
        left = [x for block in blocks if block.terminator for x in block.terminator.operands]
        left, found, live = left + self._asked, set[int](), set[int]()
        while left:
            value = left.pop()
            if id(value) in found or not isinstance(value, ir.Instruction):
                continue
            found.add(id(value))
            left += value.operands
            if value.opname == "load":
                base = id(self._base(value.operands[0]))
                if base in self._stores and base not in live:
                    live.add(base)
                    left += [x for stored in self._stores[base] for x in stored.operands]
        for base, stores in self._stores.items():
            if base not in live:
                self._changed.discard(base)
                for stored in stores:
                    stored.parent.instructions.remove(stored)

    def sweep(self, region: Region) -> None:
        """Write the way back through a region."""
        outer, self.region = self.region, region
        region.entry = self.block
        rest = self._code.append_basic_block("rest")
        self.position_at_end(rest)
        for item in reversed(region.items):
            if not isinstance(item, Node):
                item()
                continue
            found = item.cotangent
            if item.total is not None:
                more = self.load(item.total)
                found = more if found is None else self.fadd(found, more)
            if found is not None:
                for parent, pull in item.pulls:
                    self._give(parent, pull(found))
        with self.at(region.entry):
            self.branch(rest)
        self.region = outer

    def _give(self, node: Any, cotangent: Any) -> None:
        if node is None:
            return
        if node.region is self.region:
            node.cotangent = cotangent if node.cotangent is None else self.fadd(node.cotangent, cotangent)
            return
        if node.total is None:
            node.total = self.slot(cotangent.type)
            with self.at(node.region.entry):
                self.store(_all(cotangent.type), node.total)
        self.store(self.fadd(self.load(node.total), cotangent), node.total)

    # --- what is remembered ------------------------------------------------------------------------
    def depends(self, value: Any) -> bool:
        """Whether a value is one that cotangents go back to."""
        return id(value) in self.nodes

    def active_since(self, items: int) -> bool:
        """Whether something was remembered since the region had so many items."""
        return any(isinstance(item, Node) for item in self.region.items[items:])

    def _made(self, value: Any, *pulls: Pull) -> Any:
        if self.recording:
            kept = [(self.nodes[id(x)], pull) for x, pull in pulls if id(x) in self.nodes]
            if kept:
                self._note(value, kept)
        return value

    def _note(self, value: Any, pulls: list[Pull]) -> None:
        self.nodes[id(value)] = node = Node(value, pulls, self.region)
        self.region.items.append(node)

    def _no_rule(self, values: Any, what: str) -> None:
        if self.recording and any(id(x) in self.nodes for x in values):
            raise Refused(f"{what} has no derivative backwards")

    def fadd(self, x: Any, y: Any) -> Any:
        return self._made(super().fadd(x, y), (x, _same), (y, _same))

    def fsub(self, x: Any, y: Any) -> Any:
        return self._made(super().fsub(x, y), (x, _same), (y, self.fneg))

    def fmul(self, x: Any, y: Any) -> Any:
        by_x, by_y = lambda g: self.fmul(g, self.back(y)), lambda g: self.fmul(g, self.back(x))
        return self._made(super().fmul(x, y), (x, by_x), (y, by_y))

    def fdiv(self, x: Any, y: Any) -> Any:
        ratio = super().fdiv(x, y)

        def by_y(g: Any) -> Any:
            return self.fneg(self.fdiv(self.fmul(g, self.back(ratio)), self.back(y)))

        return self._made(ratio, (x, lambda g: self.fdiv(g, self.back(y))), (y, by_y))

    def fneg(self, x: Any) -> Any:
        return self._made(super().fneg(x), (x, self.fneg))

    def frem(self, x: Any, y: Any) -> Any:
        self._no_rule((x, y), "a remainder")
        return super().frem(x, y)

    def fptrunc(self, x: Any, kind: Any) -> Any:
        self._no_rule((x,), "a float32")
        return super().fptrunc(x, kind)

    def select(self, test: Any, x: Any, y: Any) -> Any:
        by_x, by_y = (
            lambda g: self.select(self.back(test), g, _all(g.type)),
            lambda g: self.select(self.back(test), _all(g.type), g),
        )
        return self._made(super().select(test, x, y), (x, by_x), (y, by_y))

    def call(self, function: Any, values: Any) -> Any:
        found, name = super().call(function, values), function.name.split(".")
        if not self.recording or not any(id(x) in self.nodes for x in values):
            return found
        (x,) = values[:1]
        if name[:2] == ["llvm", "sqrt"]:
            return self._made(found, (x, lambda g: self._over_root(g, self.back(found))))
        if name[:2] == ["llvm", "fabs"]:
            return self._made(found, (x, lambda g: self._signed(g, self.back(x))))
        if name[0] != "llvm" or name[1] not in _FLAT:
            raise Refused(f"{name[-1] if name[0] != 'llvm' else name[1]} has no derivative backwards")
        return found

    def _over_root(self, g: Any, root: Any) -> Any:
        zero, half = _all(g.type), _all(g.type, 0.5)
        return self.select(self.fcmp_ordered("<", zero, root), self.fdiv(self.fmul(g, half), root), zero)

    def _signed(self, g: Any, x: Any) -> Any:
        return self.select(self.fcmp_ordered("<", x, _all(g.type)), self.fneg(g), g)

    def insert_element(self, into: Any, x: Any, k: Any) -> Any:
        by_into, by_x = (
            lambda g: self.insert_element(g, _all(DOUBLE), k),
            lambda g: self.extract_element(g, k),
        )
        return self._made(super().insert_element(into, x, k), (into, by_into), (x, by_x))

    def extract_element(self, x: Any, k: Any) -> Any:
        by_x = lambda g: self.insert_element(_all(x.type), g, k)  # noqa: E731
        return self._made(super().extract_element(x, k), (x, by_x))

    def shuffle_vector(self, x: Any, y: Any, mask: Any) -> Any:
        """The first number in all lanes (`symbols.broadcast`)."""
        return self._made(super().shuffle_vector(x, y, mask), (x, self._summed))

    def _summed(self, g: Any) -> Any:
        total = self.extract_element(g, ir.Constant(SLOT, 0))
        for i in range(1, g.type.count):
            total = self.fadd(total, self.extract_element(g, ir.Constant(SLOT, i)))
        return self.insert_element(_all(g.type), total, ir.Constant(SLOT, 0))

    def sloped(self, y: Value, x: Value, slope: Value) -> Value:
        """y as a function of x alone, whose derivative is `slope`."""
        count = max(y.count, x.count, slope.count)
        found, by, own = y.wide(count), x.wide(count), slope.wide(count)
        self._dear.add(id(own))
        made = super().fadd(found, _all(found.type))
        return Value(self, self._made(made, (by, lambda g: self.fmul(g, self.back(own)))), count)

    def constant(self, x: Value) -> Value:
        """x without what it depends on."""
        return Value(self, super().fadd(x.value, _all(x.value.type)), x.count)

    # --- memory ------------------------------------------------------------------------------------
    def paired(self, place: Any, bar: Any, own: bool) -> None:
        """Numbers at an address have their cotangents at another; own: which begin with 0 where a number is stored."""
        self._bars[id(place)] = bar
        self._alive.append(place)
        if own:
            self._own.add(id(place))

    def has_bar(self, place: Any) -> bool:
        """Whether there are cotangents of what is at an address."""
        return id(self._base(place)) in self._bars

    def _base(self, place: Any) -> Any:
        while id(place) not in self._bars and getattr(place, "opname", "") in ("getelementptr", "bitcast"):
            place = place.operands[0]
        return place

    def _bar(self, place: Any) -> Any:
        """Where the cotangents of what is at an address are."""
        if id(place) in self._bars:
            return self.back(self._bars[id(place)])
        bar = self._bar(place.operands[0])
        if place.opname == "bitcast":
            return self.bitcast(bar, place.type)
        return self.gep(bar, [self.back(k) for k in place.indices], inbounds=True)

    def load(self, place: Any, align: int | None = None) -> Any:
        found = super().load(place, align=align)
        if self.recording and _is_number(found.type) and self.has_bar(place):
            self._note(found, [(None, lambda g: self._add(place, g))])
        return found

    def _add(self, place: Any, g: Any) -> None:
        bar = self._bar(place)
        self.store(self.fadd(self.load(bar, align=8), g), bar, align=8)

    def store(self, value: Any, place: Any, align: int | None = None) -> Any:
        made = super().store(value, place, align=align)
        if self.recording:
            base, node = id(self._base(place)), self.nodes.get(id(value))
            self._changed.add(base)
            if _is_number(value.type) and base in self._bars:
                self._stores.setdefault(base, []).append(made)
                if base in self._own:
                    super().store(_all(value.type), self._bar(place), align=8)
                self.region.items.append(lambda: self._take(place, value.type, node))
            elif node is not None:
                raise Refused("numbers are stored in an array without cotangents: name it, or call it scratch")
        return made

    def _take(self, place: Any, kind: Any, node: Any) -> None:
        bar = self._bar(place)
        if node is not None:
            self._give(node, self.load(bar, align=8))
        self.store(_all(kind, -0.0 if id(self._base(place)) in self._own else 0.0), bar, align=8)

    # --- values of the way forth -------------------------------------------------------------------
    def back(self, value: Any) -> Any:
        """A value of the way forth."""
        if self.recording or not isinstance(value, ir.Instruction):
            return value
        self._asked.append(value)
        region = self.home.get(id(value.parent))
        return value if region is None else region.again(value)

    def found_again(self, value: Any) -> bool:
        """Whether a value is what it was wherever it is found anew."""
        if value.opname == "load":
            base = self._base(value.operands[0])
            fresh = id(base) in self._bars or not isinstance(base, ir.AllocaInstr | ir.LoadInstr)
            return "invariant.load" in value.metadata or (fresh and id(base) not in self._changed)
        return value.opname in _AGAIN and id(value) not in self._dear

    def copied(self, value: Any, block: Any) -> Any:
        """The same instruction once more, at the end of a block."""
        if value.opname == "load":
            place = self.back(value.operands[0])
            with self.at(block):
                made = self.load(place, align=value.align)
            made.metadata.update(value.metadata)
            return made
        operands = [self.back(x) for x in value.operands]
        with self.at(block):
            if value.opname == "getelementptr":
                return self.gep(operands[0], operands[1:], inbounds=True)
            if isinstance(value, ir.CompareInstr):
                made = type(value)(self.block, value.op, *operands)
            elif value.opname == "select":
                return self.select(*operands)
            elif isinstance(value, ir.CastInstr):
                made = ir.CastInstr(self.block, value.opname, operands[0], value.type)
            elif value.opname == "insertelement":
                return self.insert_element(*operands)
            elif value.opname == "shufflevector":
                return self.shuffle_vector(*operands)
            else:
                made = ir.Instruction(self.block, value.type, value.opname, operands)
            self._insert(made)
        return made


def _same(g: Any) -> Any:
    return g

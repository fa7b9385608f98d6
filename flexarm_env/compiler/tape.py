"""The tape of reverse mode: an IR builder that records float64 instructions and writes the reverse sweep of cotangents.

A `Tape` writes instructions like any builder. While the tape records, each instruction that depends on a differentiated
input becomes a `Node` of the current `Region`: a function, a loop body, one side of a branch. `sweep` writes the
reverse code of a region. Each array has parallel memory for its cotangents (bars). The reverse code of a store moves
the array element's cotangent to the stored number. The reverse code of a load adds the loaded number's cotangent to the
element's. `back` returns a forward value in the reverse sweep. A value of the outermost region is still available.
Integers, addresses, cheap arithmetic and loads from unchanged arrays are recomputed; other forward values are saved.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir

from .guards import Guards
from .kinds import Refused
from .nodes import Node, Pull, Region
from .rooms import Rooms
from .symbols import DOUBLE, SLOT, Value

# LLVM operations whose derivative is 0, and opcodes that are recomputed instead of saved
_FLAT = ("floor", "ceil", "rint", "fptosi")
_AGAIN = {
    "add", "sub", "mul", "sdiv", "srem", "udiv", "urem", "and", "or", "xor", "shl", "ashr", "lshr", "icmp", "zext",
    "sext", "trunc", "inttoptr", "ptrtoint", "bitcast", "getelementptr", "insertelement", "shufflevector",
    "fadd", "fsub", "fmul", "fneg", "fcmp", "select",
}  # fmt: skip


def _is_number(kind: Any) -> bool:
    """Return whether an LLVM type is double or a vector of double."""
    return kind == DOUBLE or (isinstance(kind, ir.VectorType) and kind.element == DOUBLE)


def _all(kind: Any, x: float = -0.0) -> Any:
    """Return the constant x in all lanes of a type; -0 added to any number leaves all its bits unchanged."""
    return ir.Constant(kind, x if kind == DOUBLE else [x] * kind.count)


class Tape(Rooms):
    """Records the forward pass and writes the reverse sweep, at the position of a writer's builder.

    wide: for each function, the types of names whose slots were too narrow. nodes: dict from the id of an LLVM value to
    its `Node`. home: dict from the id of a basic block to its `Region`, without blocks of the outermost region.
    """

    def __init__(self, writer: Any, wide: dict[Any, Any]) -> None:
        """Continue at the position of `writer`, in a separate basic block for the forward pass."""
        super().__init__(writer)
        self.wide = wide
        self.nodes: dict[int, Node] = {}
        self.home: dict[int, Region] = {}
        self._bars: dict[int, Any] = {}
        # arrays whose cotangents are zeroed at each store; arrays that are stored to; stores by array
        self._own: set[int] = set()
        self._changed: set[int] = set()
        self._stores: dict[int, list[Any]] = {}
        # values too expensive to recompute; forward values that the reverse sweep uses
        self._dear: set[int] = set()
        self._asked: list[Any] = []
        self._copied: list[tuple[Any, Any, Any]] = []
        self._taken: list[Any] = []
        # stack slots of a single number
        self._names: set[int] = set()
        self._guards: Any = None
        self._alive: list[Any] = []
        self._first = writer.b.block
        self.recording = False
        self.region: Any = None
        self._forth = self._code.append_basic_block("forth")

    # --- passes ------------------------------------------------------------------------------------
    def argument(self, array: Any, bar: Any) -> Any:
        """Return the address of an array, or of its copy if the code writes to it. bar: its cotangents, or None."""
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
        # the address is filled in by `finish`, once it is known whether a copy is needed
        with self.at(self._forth):
            data = self.load(slot)
        self._copied.append((slot, data, (array.data, size, bar is None)))
        self.paired(data, cotangents, own=bar is None)
        return data

    def begin(self) -> None:
        """Start to record the forward pass in a new basic block, which belongs to the outermost region."""
        self._first = self.block
        self.position_at_end(self._forth)
        self._begin = len(self._code.blocks)
        self.region = self.whole = Region(self, self._code, self._forth)
        # values of the outermost region are at hand in the reverse sweep, so it needs no home
        del self.home[id(self._forth)]
        self.recording = True

    def finish(self) -> None:
        """Emit the reverse sweep, copies of arrays that the forward pass overwrites, and the release of memory."""
        self.recording, self._end = False, len(self._code.blocks)
        self._guards = Guards(self.nodes.values(), self._names)
        back = self._code.append_basic_block("back")
        self.branch(back)
        self.position_at_end(back)
        self.sweep(self.whole)
        for room in self._taken:
            self.given_back(room)
        # stores that nothing needs are dropped before it is decided which arrays need a copy
        end = self.block
        self._leave_out()
        self.position_at_end(self._first)
        # prologue: copy overwritten arrays, so that the caller's stay unchanged; scratch is used in place
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
        """Delete stores of the forward pass to memory that neither the control flow nor the sweep reads later."""
        blocks = [self._forth, *self._code.blocks[self._begin :]]
        left = [x for block in blocks if block.terminator for x in block.terminator.operands]
        left, found, live = left + self._asked, set[int](), set[int]()
        # mark all instructions needed by branches and by values that the reverse sweep uses
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
        # an array without needed loads is not overwritten any more
        for base, stores in self._stores.items():
            if base not in live:
                self._changed.discard(base)
                for stored in stores:
                    stored.parent.instructions.remove(stored)

    def sweep(self, region: Region) -> None:
        """Write a region's reverse code, from its last item to its first; the entry block recomputes forward values."""
        outer, self.region = self.region, region
        region.entry = self.block
        rest = self._code.append_basic_block("rest")
        self.position_at_end(rest)
        for item in reversed(region.items):
            if not isinstance(item, Node):
                item()
                continue
            found = item.cotangent
            # add the cotangents that came from other regions
            if item.total is not None:
                more = self.load(item.total)
                found = more if found is None else self.fadd(found, more)
            if found is not None:
                self._pull(item, found)
        with self.at(region.entry):
            self.branch(rest)
        self.region = outer

    def _pull(self, node: Node, found: Any) -> None:
        """Propagate a node's cotangent `found` to its operands, masked by the guards of each edge (`guards`)."""
        live = self._guards.live(node)
        if live is not None:
            live.test = self.fcmp_unordered("!=", found, _all(found.type, 0.0))
        for pull in node.pulls:
            gathers = pull.gathers or pull.parent is None
            guards = self._guards.left(node, None if gathers else pull.parent)
            # mask before lanes are mixed or memory is added to, otherwise after the pullback
            if gathers:
                self._give(pull.parent, pull.apply(self._chosen(guards, found)))
            else:
                self._give(pull.parent, self._chosen(guards, pull.apply(found)))

    def _chosen(self, guards: list[Any], cotangent: Any) -> Any:
        """Mask a cotangent by guards: replace it by -0 where a guard is false."""
        for guard in guards:
            cotangent = guard.masked(self, cotangent, _all(cotangent.type))
        return cotangent

    def _give(self, node: Any, cotangent: Any) -> None:
        """Add a cotangent to that of a node: at compile time within one region, otherwise in a stack slot."""
        if node is None:
            return
        if node.region is self.region:
            node.cotangent = cotangent if node.cotangent is None else self.fadd(node.cotangent, cotangent)
            return
        # the slot is zeroed where the reverse code of the node's region begins
        if node.total is None:
            node.total = self.slot(cotangent.type)
            with self.at(node.region.entry):
                self.store(_all(cotangent.type), node.total)
        self.store(self.fadd(self.load(node.total), cotangent), node.total)

    # --- recording ---------------------------------------------------------------------------------
    def depends(self, value: Any) -> bool:
        """Return True if an LLVM value is active, that is, depends on a differentiated input."""
        return id(value) in self.nodes

    def active_since(self, items: int) -> bool:
        """Return whether a node was recorded after the first `items` items of the current region."""
        return any(isinstance(item, Node) for item in self.region.items[items:])

    def _made(self, value: Any, *pulls: tuple[Any, ...], **about: Any) -> Any:
        """Record `value` as a node if an operand is active. pulls: operand, pullback, ...; about: for `Node`."""
        if self.recording:
            kept = [Pull(self.nodes[id(x)], *rest) for x, *rest in pulls if id(x) in self.nodes]
            if kept:
                self._note(value, kept, **about)
        return value

    def _note(self, value: Any, pulls: list[Pull], **about: Any) -> Node:
        """Record a node with the given edges in the current region, and return the node."""
        self.nodes[id(value)] = node = Node(value, pulls, self.region, **about)
        self.region.items.append(node)
        return node

    def _no_rule(self, values: Any, what: str) -> None:
        """Refuse an operation without a reverse rule if an operand is active."""
        if self.recording and any(id(x) in self.nodes for x in values):
            raise Refused(f"{what} has no derivative backwards")

    def fadd(self, x: Any, y: Any) -> Any:
        return self._made(super().fadd(x, y), (x, _same), (y, _same))

    def fsub(self, x: Any, y: Any) -> Any:
        return self._made(super().fsub(x, y), (x, _same), (y, self.fneg))

    def fmul(self, x: Any, y: Any) -> Any:
        """Emit x times y. The product's cotangent g adds g y to the cotangent of x and g x to the cotangent of y."""
        by_x, by_y = lambda g: self.fmul(g, self.back(y)), lambda g: self.fmul(g, self.back(x))
        return self._made(super().fmul(x, y), (x, by_x), (y, by_y), risky=True)

    def fdiv(self, x: Any, y: Any) -> Any:
        """Emit x / y. The ratio's cotangent g adds g / y to the cotangent of x and -(g (x / y)) / y to that of y."""
        ratio = super().fdiv(x, y)

        def by_y(g: Any) -> Any:
            return self.fneg(self.fdiv(self.fmul(g, self.back(ratio)), self.back(y)))

        return self._made(ratio, (x, lambda g: self.fdiv(g, self.back(y))), (y, by_y), risky=True, steep=True)

    def fneg(self, x: Any) -> Any:
        return self._made(super().fneg(x), (x, self.fneg))

    def frem(self, x: Any, y: Any) -> Any:
        self._no_rule((x, y), "a remainder")
        return super().frem(x, y)

    def fptrunc(self, x: Any, kind: Any) -> Any:
        self._no_rule((x,), "a float32")
        return super().fptrunc(x, kind)

    def select(self, test: Any, x: Any, y: Any) -> Any:
        """Emit a select of x or y. The reverse code adds its cotangent to that of the chosen operand."""
        by_x, by_y = (
            lambda g: self.select(self.back(test), g, _all(g.type)),
            lambda g: self.select(self.back(test), _all(g.type), g),
        )
        return self._made(super().select(test, x, y), (x, by_x, True), (y, by_y, False), test=test)

    def call(self, function: Any, values: Any) -> Any:
        """Emit a call. Only sqrt, fabs, floor, ceil, rint and fptosi have derivatives; others are `Refused`."""
        found, name = super().call(function, values), function.name.split(".")
        if not self.recording or not any(id(x) in self.nodes for x in values):
            return found
        (x,) = values[:1]
        if name[:2] == ["llvm", "sqrt"]:
            return self._made(found, (x, lambda g: self._over_root(g, self.back(found))), risky=True, steep=True)
        if name[:2] == ["llvm", "fabs"]:
            return self._made(found, (x, lambda g: self._signed(g, self.back(x))))
        if name[0] != "llvm" or name[1] not in _FLAT:
            raise Refused(f"{name[-1] if name[0] != 'llvm' else name[1]} has no derivative backwards")
        return found

    def _over_root(self, g: Any, root: Any) -> Any:
        """Return the pullback of a square root: g / (2 root), 0 where the root is 0 or NaN."""
        zero, half = _all(g.type), _all(g.type, 0.5)
        return self.select(self.fcmp_ordered("<", zero, root), self.fdiv(self.fmul(g, half), root), zero)

    def _signed(self, g: Any, x: Any) -> Any:
        """Return the pullback of |x|: -g where x < 0, otherwise g."""
        return self.select(self.fcmp_ordered("<", x, _all(g.type)), self.fneg(g), g)

    def insert_element(self, into: Any, x: Any, k: Any) -> Any:
        """Emit the vector `into` with lane k replaced by x. Lane k's cotangent goes to x, the rest to `into`."""
        by_into, by_x = (
            lambda g: self.insert_element(g, _all(DOUBLE), k),
            lambda g: self.extract_element(g, k),
        )
        return self._made(super().insert_element(into, x, k), (into, by_into), (x, by_x, None, True))

    def extract_element(self, x: Any, k: Any) -> Any:
        """Emit the extraction of lane k; the cotangent goes to lane k of the vector."""
        by_x = lambda g: self.insert_element(_all(x.type), g, k)  # noqa: E731
        return self._made(super().extract_element(x, k), (x, by_x, None, True))

    def shuffle_vector(self, x: Any, y: Any, mask: Any) -> Any:
        """Emit a broadcast of lane 0 to all lanes (`symbols.broadcast`); the cotangents of all lanes are summed."""
        return self._made(super().shuffle_vector(x, y, mask), (x, self._summed, None, True))

    def _summed(self, g: Any) -> Any:
        """Return the sum of all lanes, from the first to the last, in lane 0 and -0 elsewhere."""
        total = self.extract_element(g, ir.Constant(SLOT, 0))
        for i in range(1, g.type.count):
            total = self.fadd(total, self.extract_element(g, ir.Constant(SLOT, i)))
        return self.insert_element(_all(g.type), total, ir.Constant(SLOT, 0))

    def sloped(self, y: Value, x: Value, slope: Value) -> Value:
        """Return y as a function of x alone with the derivative `slope`, which is saved for the reverse sweep."""
        count = max(y.count, x.count, slope.count)
        found, by, own = y.wide(count), x.wide(count), slope.wide(count)
        self._dear.add(id(own))
        made = super().fadd(found, _all(found.type))
        return Value(self, self._made(made, (by, lambda g: self.fmul(g, self.back(own))), risky=True), count)

    def constant(self, x: Value) -> Value:
        """Return x as a constant for the derivative: a new LLVM value x + (-0) without a node."""
        return Value(self, super().fadd(x.value, _all(x.value.type)), x.count)

    # --- memory ------------------------------------------------------------------------------------
    def paired(self, place: Any, bar: Any, own: bool) -> None:
        """Record that the cotangents of the memory at `place` are at the address `bar`. own: stores set them to 0."""
        self._bars[id(place)] = bar
        if isinstance(place, ir.AllocaInstr) and not isinstance(place.type.pointee, ir.ArrayType):
            self._names.add(id(place))
        self._alive.append(place)
        if own:
            self._own.add(id(place))

    def has_bar(self, place: Any) -> bool:
        """Return whether the memory at an address has cotangents."""
        return id(self._base(place)) in self._bars

    def _base(self, place: Any) -> Any:
        """Return the registered array or stack slot from which gep and bitcast computed an address."""
        while id(place) not in self._bars and getattr(place, "opname", "") in ("getelementptr", "bitcast"):
            place = place.operands[0]
        return place

    def _bar(self, place: Any) -> Any:
        """Return the address of the cotangents that belong to an address in an array or stack slot."""
        if id(place) in self._bars:
            return self.back(self._bars[id(place)])
        bar = self._bar(place.operands[0])
        if place.opname == "bitcast":
            return self.bitcast(bar, place.type)
        return self.gep(bar, [self.back(k) for k in place.indices], inbounds=True)

    def load(self, place: Any, align: int | None = None) -> Any:
        """Emit a load from `place`. The reverse code adds the number's cotangent to that of the memory."""
        found = super().load(place, align=align)
        if self.recording and _is_number(found.type) and self.has_bar(place):
            self._note(found, [Pull(None, lambda g: self._add(place, g))]).base = id(self._base(place))
        return found

    def _add(self, place: Any, g: Any) -> None:
        """Emit code that adds g to the cotangents of an address."""
        bar = self._bar(place)
        self.store(self.fadd(self.load(bar, align=8), g), bar, align=8)

    def store(self, value: Any, place: Any, align: int | None = None) -> Any:
        """Emit a store. The reverse code moves the cotangent of `place` to that of the stored number.

        Raises a compile error (`Refused`) if a number that depends on a differentiated input is stored in memory
        without cotangents.
        """
        made = super().store(value, place, align=align)
        if self.recording:
            base, node = id(self._base(place)), self.nodes.get(id(value))
            self._changed.add(base)
            if _is_number(value.type) and base in self._bars:
                self._stores.setdefault(base, []).append(made)
                if node is not None:
                    node.stored.append(base)
                if base in self._own:
                    super().store(_all(value.type), self._bar(place), align=8)
                self.region.items.append(lambda: self._take(place, value.type, node))
            elif node is not None:
                raise Refused("numbers are stored in an array without cotangents: name it, or call it scratch")
        return made

    def _take(self, place: Any, kind: Any, node: Any) -> None:
        """Emit the reverse of a store: add the memory's cotangent to the stored node's, if any, then set it to 0."""
        bar = self._bar(place)
        if node is not None:
            self._give(node, self.load(bar, align=8))
        self.store(_all(kind, -0.0 if id(self._base(place)) in self._own else 0.0), bar, align=8)

    # --- forward values ----------------------------------------------------------------------------
    def back(self, value: Any) -> Any:
        """Return a forward value for the reverse sweep: the value if still available, else recomputed or reloaded."""
        if self.recording or not isinstance(value, ir.Instruction):
            return value
        self._asked.append(value)
        region = self.home.get(id(value.parent))
        return value if region is None else region.again(value)

    def found_again(self, value: Any) -> bool:
        """Return whether a forward value is recomputed: a cheap operation, or a load from unchanged memory."""
        if value.opname == "load":
            base = self._base(value.operands[0])
            fresh = id(base) in self._bars or not isinstance(base, ir.AllocaInstr | ir.LoadInstr)
            return "invariant.load" in value.metadata or (fresh and id(base) not in self._changed)
        return value.opname in _AGAIN and id(value) not in self._dear

    def copied(self, value: Any, block: Any) -> Any:
        """Recompute a forward value: write its instruction again, with operands from `back`, at the end of `block`."""
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

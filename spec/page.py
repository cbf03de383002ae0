"""Encoded pages: chapters 1 and 6 of slice-archive.md."""

SIDE = 64
TOP = 16320
SLICE = 255
FIFTH, THIRD = SLICE // 5, SLICE // 3
ONE = 1 << 32  # a quantum, in the unit of steps
STEPS = 1 << 14

N = [2, 3, 3, 3, 3, 4, 4, 4, 4, 4, 5, 5, 5, 5, 5, 6]
B = [1, 2, 3, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5]
COUNT_WEIGHTS = [800, 120, 40, 20, 10, 5, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1]
HEIGHT_WEIGHTS = [60, 40, 60, 90, 130, 160, 160, 130, 90, 60, 40, 30, 30, 25, 10, 1]


class Refused(Exception):
    """The archive breaks a rule."""

    def __init__(self, rule, text):
        super().__init__(f"{rule}: {text}")
        self.rule = rule


def need(condition, rule, text):
    if not condition:
        raise Refused(rule, text)


# Section 6.1: symbols.


class Models(list):
    """Models of one name, each a list of its state and how many symbols it has seen."""

    def __init__(self, name, states):
        super().__init__([state, 0] for state in states)
        self.name = name


def bits(name, count, ones):
    return Models(name, [ones] * count)


def nibbles(name, count, weights):
    total = sum(weights)
    below = [32752 * sum(weights[:i]) // total for i in range(16)]
    return Models(name, [below] * count)


class Symbols:
    """Takes symbols from a body; `trace`, if any, is told of each with the state after it, and of what they mean."""

    def __init__(self, body, trace=None):
        self.trace = trace
        need(len(body) >= 5 and len(body) % 2 == 1, "P6", f"a body of {len(body)} bytes")
        self.state = int.from_bytes(body[1:5], "little")
        need(self.state >= 65536, "P6", f"state {self.state} at the start")
        self.words = [int.from_bytes(body[at : at + 2], "little") for at in range(len(body) - 2, 4, -2)]

    def _advance(self, slot, start, count):
        state = count * (self.state >> 15) + slot - start
        if state < 65536:
            need(self.words, "P6", "words are missing")
            state = state << 16 | self.words.pop()
        self.state = state

    def _done(self, name, value, start, count):
        if self.trace:
            self.trace(f"{name:14} {value:5}  {start:5} {count:5}  {self.state:08x}", True)
        return value

    def note(self, text):
        if self.trace:
            self.trace(text, False)

    def raw(self, n):
        slot = self.state & 32767
        value = slot >> (15 - n)
        start, count = value << (15 - n), 1 << (15 - n)
        self._advance(slot, start, count)
        return self._done(f"raw({n})", value, start, count)

    def nibble(self, models, index):
        model = models[index]
        below, seen = model
        slot = self.state & 32767
        value = 15
        while below[value] + value > slot:
            value -= 1
        start = below[value] + value
        end = below[value + 1] + value + 1 if value < 15 else 32768
        self._advance(slot, start, end - start)
        r = N[seen]
        model[0] = [b - (b >> r) for b in below[: value + 1]] + [b + (32752 - b >> r) for b in below[value + 1 :]]
        model[1] = min(seen + 1, 15)
        return self._done(f"{models.name}[{index}]", value, start, end - start)

    def bit(self, models, index):
        model = models[index]
        ones, seen = model
        slot = self.state & 32767
        zeros = 32768 - ones
        r = B[seen]
        model[1] = min(seen + 1, 15)
        if slot < zeros:
            model[0] = ones - (ones - 32 >> r)
            self._advance(slot, 0, zeros)
            return self._done(f"{models.name}[{index}]", 0, 0, zeros)
        model[0] = ones + (32736 - ones >> r)
        self._advance(slot, zeros, ones)
        return self._done(f"{models.name}[{index}]", 1, zeros, ones)

    def finish(self):
        need(self.state == 65536 and not self.words, "P6", f"state {self.state}, {len(self.words)} words at the end")


# Section 6.2: steps of heights.


class Lattice:
    def __init__(self, step=ONE, phase=0):
        self.step, self.phase = step, phase
        self.every = step == ONE

    @classmethod
    def read(cls, symbols):
        if not symbols.raw(1):
            return cls()
        step, phase = (
            symbols.raw(10) << 30 | symbols.raw(10) << 20 | symbols.raw(10) << 10 | symbols.raw(10) for _ in range(2)
        )
        need(2 * ONE <= step <= 255 * ONE and phase < step, "P7", f"steps of {step} and phase {phase}")
        return cls(step, phase)

    def usual(self, end, i):
        floor = self.phase + i * self.step >> 32
        return floor if self.every else floor + end

    def next(self, height):
        return -((self.phase - height * ONE) // self.step)


# Section 6.4: contexts.


def klass(v):
    return (0, 0, 0, 1, 2, 3, 4, 5, 6, 6)[v.bit_length()] if v.bit_length() < 10 else 7


def spread(values):
    return max(values) - min(values) if len(values) > 1 else 0


class Span:
    """A span with its steps; `codes` are how its heights were coded: None for a boundary, else step and offset."""

    __slots__ = ("bottom", "top", "obstacle", "low", "high", "codes", "inferred")

    def thickness(self):
        return self.high - self.low


class Page:
    """The content of a page: `columns[64 * py + px]` are the spans of a pixel."""

    def __new__(cls, body, trace=None):
        return super().__new__(Braided if cls is Page and body[0] in (3, 4) else cls)

    def __init__(self, body, trace=None):
        need(body[0] in (1, 2, 3, 4), "P5", f"model {body[0]}")
        self.model, runs = body[0], []
        self.is_braided = self.model > 2
        if self.model in (2, 4):
            runs, body = read_runs(body)
        self.read_spans(body, trace)
        self.symbols.finish()
        need(any(self.columns), "P6", "no pixel is occupied")
        del self.symbols
        self.mark(runs)

    def read_spans(self, body, trace):
        self.symbols = Symbols(body, trace)
        self.lattice = Lattice.read(self.symbols)
        self.count = nibbles("count", 16, COUNT_WEIGHTS)
        self.heights = nibbles("bottom", 16, HEIGHT_WEIGHTS), nibbles("thickness", 80, HEIGHT_WEIGHTS)
        self.second = [bits(f"second[{end}]", 16, 13312) for end in range(2)]
        self.off = [Models(f"off[{end}]", [1024, 1024, 16384, 1024]) for end in range(2)]
        self.up = bits("up", 2, 16384)
        self.kind = bits("kind", 50, 16384)
        self.last = {}, {}
        self.coded_last = None
        self.read_blocks()
        self.read_pixels()

    # Section 6.6: inferred spans.

    def mark(self, runs):
        floors = [span for column in self.columns for span in column if not span.obstacle]
        need(sum(runs) <= len(floors), "P12", f"runs of {sum(runs)} of {len(floors)} floor spans")
        at = 0
        for number, run in enumerate(runs):
            for span in floors[at : at + run]:
                span.inferred = number % 2 == 1
            at += run

    # Section 6.3: pixels with matter.

    def read_blocks(self):
        matter, full = bits("matter", 9, 16384), bits("full", 9, 8192)
        self.blocks = blocks = [0] * 64
        for at in range(64):
            west = blocks[at - 1] if at % 8 else 0
            north = blocks[at - 8] if at >= 8 else 0
            context = 3 * west + north
            if self.symbols.bit(matter, context):
                blocks[at] = 1 + self.symbols.bit(full, context)

    def read_pixels(self):
        pixel = bits("pixel", 64, 16384)
        self.columns = columns = [[] for _ in range(SIDE * SIDE)]

        def has(px, py):
            return 0 <= px < SIDE and py >= 0 and bool(columns[SIDE * py + px])

        for py in range(SIDE):
            for px in range(SIDE):
                block = self.blocks[py // 8 * 8 + px // 8]
                if block == 1:
                    context = (
                        has(px - 2, py)
                        + 2 * has(px - 1, py)
                        + 4 * has(px - 1, py - 1)
                        + 8 * has(px, py - 1)
                        + 16 * has(px + 1, py - 1)
                        + 32 * has(px, py - 2)
                    )
                    block = 2 * self.symbols.bit(pixel, context)
                if block == 2:
                    self.read_column(px, py)

    # Section 6.4: spans.

    def read_column(self, px, py):
        def near(x, y):
            return self.columns[SIDE * y + x] if 0 <= x < SIDE and y >= 0 else []

        self.symbols.note(f"pixel ({px}, {py})")
        west, north = near(px - 1, py), near(px, py - 1)
        neighbours = [near for near in (west, north, near(px - 1, py - 1), near(px + 1, py - 1)) if near]
        context = 4 * min(len(west), 3) + min(len(north), 3)
        count, more = 1, 15
        while more == 15 and count <= 64:
            more = self.symbols.nibble(self.count, context)
            count += more
        need(count <= 64, "P7", f"{count} spans in pixel ({px}, {py})")
        column = self.columns[SIDE * py + px]
        for _ in range(count):
            column.append(self.read_span(neighbours, column[-1] if column else None))

    def read_span(self, neighbours, before):
        if before is None:
            candidates = [near[0] for near in neighbours]
        else:
            found = (next((span for span in near if span.bottom > before.top), None) for near in neighbours)
            candidates = [span for span in found if span]
        m = len(candidates)
        lows = [span.low for span in candidates]
        thicks = [span.thickness() for span in candidates]
        if m >= 3:
            bottom, thick = sorted(lows)[1], sorted(thicks)[1]
        elif m:
            bottom, thick = lows[0], thicks[0]
        elif before:
            bottom, thick = before.high, before.thickness()
        elif self.coded_last:
            bottom, thick = self.coded_last.low, self.coded_last.thickness()
        else:
            bottom, thick = 0, 0
        low_class, thick_class = klass(spread(lows)), klass(spread(thicks))
        if m < 2:
            of_bottom, a = m, m
        else:
            of_bottom, a = 2 + low_class // 2 if m == 2 else 8 + low_class, 2 + thick_class
        span = Span()
        span.inferred = False
        span.bottom, span.low, first = self.read_height(0, of_bottom, bottom)
        context = 10 * klass(abs(thick)) + a
        span.top, span.high, second = self.read_height(1, context, span.low + thick)
        span.codes = first, second
        obstacles = sum(near.obstacle for near in candidates)
        span.obstacle = self.symbols.bit(self.kind, 2 * (5 * obstacles + m) + (span.top - span.bottom > 63))
        if self.symbols.trace:
            kind = "obstacle" if span.obstacle else "floor"
            steps = "" if self.lattice.every else f" (steps {span.low}, {span.high})"
            text = f"{kind} {span.bottom} ..= {span.top}{steps}; {m} candidates, expected {bottom}, thickness {thick}"
            self.symbols.note(text)
        check_span(span.bottom, span.top, "P8")
        self.check_apart(before, span)
        self.coded_last = span
        return span

    @staticmethod
    def check_apart(before, span):
        if before:
            touching = span.bottom == before.top and span.bottom % SLICE == 0 and span.obstacle != before.obstacle
            need(span.bottom > before.top or touching, "P8", f"spans to {before.top} and from {span.bottom}")

    def read_height(self, end, context, expected):
        symbols = self.symbols
        n = symbols.nibble(self.heights[end], context)
        if n == 15:
            height = symbols.raw(7) * SLICE
            return height, self.lattice.next(height), None
        residual = min(n, 1)
        if n >= 2:
            residual = 2 | symbols.bit(self.second[end], n)
            if n > 2:
                residual = residual << (n - 2) | symbols.raw(n - 2)
        residual = -(residual + 1 >> 1) if residual & 1 else residual >> 1
        step = (expected + residual) % STEPS
        offset = 0
        if not self.lattice.every:
            last = self.last[end].get(step, 0)
            if symbols.bit(self.off[end], last):
                offset = 1 if symbols.bit(self.up, end) else -1
            self.last[end][step] = 2 if offset else 1
        return self.lattice.usual(end, step) + offset, step, (step, offset)

    # Section 6.5: the one encoding. The symbols of a page are those of a writer, if blocks, steps and heights are
    # coded as a writer must; states and words follow from the symbols.

    def check_encoding(self, slice_height, moved=0, level_step=None):
        for at, kind in enumerate(self.blocks):
            first = at // 8 * 8 * SIDE + at % 8 * 8
            pixels = [bool(self.columns[first + SIDE * y + x]) for y in range(8) for x in range(8)]
            true_kind = 2 if all(pixels) else int(any(pixels))
            need(kind == true_kind, "P10", f"block {at} has kind {kind}, should have {true_kind}")
        spans = [span for column in self.columns for span in column]
        heights = [(end, height) for span in spans for end, height in enumerate((span.bottom, span.top))]
        mine = self.lattice.step, self.lattice.phase
        # Coarsened heights of archives before 1.3 are on none but the steps of scans.
        lattices = [find_lattice(heights, slice_height, moved, level_step, self.choose)]
        lattices += [find_lattice(heights, slice_height)] if moved and self.model < 3 else []
        need(mine in lattices, "P10", f"step and phase are {mine}, should be {lattices[0]}")
        codes = (code for span in spans for code in span.codes)
        for (end, height), code in zip(heights, codes):
            best = self.code_of(end, height)
            need(code == best, "P10", f"height {height} is coded as {code}, should be {best}")

    @staticmethod
    def choose(low, high, step):
        return (low + high) // 2 % step

    def code_of(self, end, height):
        for offset in (0, 1, -1):
            if self.lattice.every:
                step = height
            else:
                step = max(self.lattice.next(height - offset - end), 0)
            if step < STEPS and self.lattice.usual(end, step) + offset == height:
                return step, offset
        return None


# Section 6.7: models 3 and 4.

RATES = [3, 3, 3, 3, 4, 4, 4, 4, 4, 5, 5, 5, 5, 5, 5, 6]
SHAPE = [8, 8, 8, 8, 8, 8, 8, 8, 12, 16, 20, 35, 60, 110, 210, 300, 110, 45, 20, 12, 8, 6, 4, 3] + [2] * 7
BOTTOM_PEAKS = [9, 6, 4, 6, 7, 9, 9, 9, 3, 3, 4, 5, 6, 6, 8, 10], [8, 6, 2, 7, 8, 11, 9, 9, 1, 2, 5, 6, 8, 9, 10, 12]
THICKNESS_PEAKS = [0, 3, 5, 6, 7, 8, 9, 11], [0, 6, 7, 8, 9, 10, 11, 12]
THIN_WEIGHTS = (
    [450, 30, 60, 60, 60, 70, 80, 80, 70, 50, 30, 15, 6, 3, 2, 2],
    [300, 95, 95, 45, 60, 30, 85, 80, 70, 50, 35, 30, 20, 5, 2, 5],
)
COUNTS = (
    [880, 80, 20, 6, 3, 2] + [1] * 10,
    [450, 390, 100, 30, 10, 5, 2] + [1] * 9,
    [200, 280, 240, 120, 60, 35, 20, 10, 5, 2] + [1] * 6,
)
PIXELS = [3300, 8500, 17000, 19500, 21500, 24000, 28000]
LEAST = (
    [0, 1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096, 8192, 0],
    [0, 1, 2, 3, 4, 6, 8, 16, 32, 64, 128, 256, 512, 1024, 4096, 0],
)
BITS = [0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 7], [0, 0, 0, 0, 1, 1, 3, 4, 5, 6, 7, 8, 9, 12, 14, 7]


def starts(weights):
    return [(32752 * sum(weights[:i]) // sum(weights)) + i for i in range(16)]


def peaked(peak):
    return starts([SHAPE[15 + i - peak] for i in range(15)] + [2])


class Braid(Symbols):
    """Takes symbols from a body of model 3; the strand of a symbol follows from its model."""

    def __init__(self, body, trace=None):
        self.trace, self.body = trace, body[1:]
        need(len(self.body) >= 8, "P6", f"a body of {len(body)} bytes")
        self.states = [int.from_bytes(self.body[at : at + 4], "little") for at in (0, 4)]
        need(min(self.states) >= 65536, "P6", f"states {self.states} at the start")
        self.at, self.taken = 8, 0

    def _take(self, strand, slot, start, count):
        state = count * (self.states[strand] >> 15) + slot - start
        if state < 65536:
            need(self.at + 2 <= len(self.body), "P6", "words are missing")
            state = state << 16 | int.from_bytes(self.body[self.at : self.at + 2], "little")
            self.at += 2
        self.states[strand] = self.state = state

    def raw(self, n):
        value = int.from_bytes(self.body, "big") >> self.taken & ((1 << n) - 1)
        self.taken += n
        self.state = 0
        return self._done(f"raw({n})", value, 0, 0)

    def nibble(self, models, index, strand):
        model = models[index]
        first, seen = model
        slot = self.states[strand] & 32767
        value = max(i for i in range(16) if first[i] <= slot)
        end = first[value + 1] if value < 15 else 32768
        count = end - first[value]
        self._take(strand, slot, first[value], count)
        r = RATES[seen]
        model[0] = [s + ((i + (32752 if i > value else 0) - s) >> r) for i, s in enumerate(first)]
        model[1] = min(seen + 1, 15)
        return self._done(f"{models.name}[{index}]", value, first[value], count)

    def bit(self, models, index, strand):
        model = models[index]
        ones, seen = model
        slot = self.states[strand] & 32767
        value = int(slot >= 32768 - ones)
        start, count = (32768 - ones, ones) if value else (0, 32768 - ones)
        model[0] = ones + ((32736 if value else 32) - ones >> B[seen])
        model[1] = min(seen + 1, 15)
        self._take(strand, slot, start, count)
        return self._done(f"{models.name}[{index}]", value, start, count)

    def finish(self):
        used = self.at + (self.taken + 7) // 8
        need(used == len(self.body) and self.states == [65536] * 2, "P6", f"{used} bytes of {len(self.body)}, states {self.states}")
        left = self.body[self.at] >> self.taken % 8 if self.taken % 8 else 0
        need(left == 0, "P6", "bits are left")


class Braided(Page):
    """A page of model 3 or 4."""

    def read_spans(self, body, trace):
        self.symbols = symbols = Braid(body, trace)
        self.lattice = self.read_lattice()
        some = 0 if self.lattice.every else 1
        self.least, self.extra = LEAST[some], BITS[some]
        self.count = Models("count", [starts(COUNTS[max(i // 4, i % 4, 1) - 1]) for i in range(16)])
        thickness = [starts(THIN_WEIGHTS[some])] * 10 + [peaked(THICKNESS_PEAKS[some][i // 10]) for i in range(10, 80)]
        self.heights = Models("bottom", map(peaked, BOTTOM_PEAKS[some])), Models("thickness", thickness)
        self.off = Models("off", [starts([1] * 16)])
        self.surprise = bits("surprise", 16, 1024)
        kinds = []
        for i in range(50):
            o, m, h = i // 10, i // 2 % 5, i % 2
            kinds.append(min(32000, 32768 * (2 * o + 3) // (2 * m + 4) if h else 32768 * (2 * o + 1) // (4 * m + 8)))
        self.kind = Models("kind", kinds)
        self.last = {}, {}
        self.expected = 0, 0
        self.read_matter()
        for py in range(SIDE):
            for px in range(SIDE):
                if self.matter[SIDE * py + px]:
                    self.read_column(px, py)
        del symbols

    def read_lattice(self):
        if not self.symbols.raw(1):
            return Lattice()

        def number():
            zeros = self.symbols.raw(6)
            need(zeros <= 40, "P7", f"{zeros} zeros end a number of 40 bits")
            low = min(40 - zeros, 20)
            value = self.symbols.raw(low)
            return (value | self.symbols.raw(40 - zeros - low) << low) << zeros

        step, phase = number(), number()
        need(2 * ONE <= step <= 255 * ONE and phase < step, "P7", f"steps of {step} and phase {phase}")
        return Lattice(step, phase)

    def read_matter(self):
        kinds = [(west, north) for west in range(3) for north in range(3)]
        matter = Models("matter", [[2600, 21500, 31000][min(sum(kind), 2)] for kind in kinds])
        full = Models("full", [1500, 1500, 23000, 1500, 1500, 12500, 23000, 12500, 29000])
        pixel = Models("pixel", [PIXELS[i.bit_count()] for i in range(64)])
        self.blocks = blocks = [0] * 64
        for at in range(64):
            context = 3 * (blocks[at - 1] if at % 8 else 0) + (blocks[at - 8] if at >= 8 else 0)
            if self.symbols.bit(matter, context, 0):
                blocks[at] = 1 + self.symbols.bit(full, context, 1)
        self.columns = [[] for _ in range(SIDE * SIDE)]
        self.matter = found = [0] * (SIDE * SIDE)

        def has(px, py):
            return found[SIDE * py + px] if 0 <= px < SIDE and py >= 0 else 0

        places = ((-2, 0), (-1, 0), (-1, -1), (0, -1), (1, -1), (0, -2))
        for py in range(SIDE):
            for px in range(SIDE):
                block = blocks[py // 8 * 8 + px // 8]
                if block == 1:
                    context = sum(has(px + x, py + y) << at for at, (x, y) in enumerate(places))
                    found[SIDE * py + px] = self.symbols.bit(pixel, context, px % 2)
                elif block == 2:
                    found[SIDE * py + px] = 1

    def read_column(self, px, py):
        def near(x, y):
            return self.columns[SIDE * y + x] if 0 <= x < SIDE and y >= 0 else []

        self.symbols.note(f"pixel ({px}, {py})")
        around = near(px - 1, py), near(px, py - 1), near(px - 1, py - 1), near(px + 1, py - 1)
        context = 4 * min(len(around[0]), 3) + min(len(around[1]), 3)
        count, more = 1, 15
        while more == 15 and count <= 64:
            more = self.symbols.nibble(self.count, context, 1)
            count += more
        need(count <= 64, "P7", f"{count} spans in pixel ({px}, {py})")
        column = self.columns[SIDE * py + px]
        for _ in range(count):
            column.append(self.read_span(around, column[-1] if column else None))
        self.expected = column[-1].low, column[-1].thickness()

    def read_span(self, around, before):
        top = before.top if before else -1
        found = (next((span for span in near if span.bottom > top), None) for near in around)
        candidates = [span for span in found if span]
        m, o = len(candidates), sum(span.obstacle for span in candidates)
        lows = sorted(span.low for span in candidates)
        thicks = sorted(span.thickness() for span in candidates)
        if m:
            low, thick = (values[1 if m > 2 else 0] for values in (lows, thicks))
        else:
            low, thick = self.expected
        low_class, thick_class = klass(spread(lows)), klass(spread(thicks))
        if m < 2:
            of_bottom, a = m, m
        else:
            of_bottom, a = 2 + low_class // 2 if m == 2 else 8 + low_class, 2 + thick_class
        codes = self.symbols.nibble(self.heights[0], of_bottom, 0), self.symbols.nibble(
            self.heights[1], 10 * klass(abs(thick)) + a, 1
        )
        extra = [self.extra[code] for code in codes]
        both = self.symbols.raw(sum(extra))
        values = both & ((1 << extra[0]) - 1), both >> extra[0]
        span = Span()
        span.inferred = False
        steps, heights, expected = [], [], low
        for end, (code, value) in enumerate(zip(codes, values)):
            if code == 15:
                heights.append(value * SLICE)
                steps.append(self.lattice.next(value * SLICE))
            else:
                residual = self.least[code] + value
                residual = -(residual + 1 >> 1) if residual & 1 else residual >> 1
                steps.append((expected + residual) % STEPS)
                heights.append(self.lattice.usual(end, steps[-1]))
            expected = steps[0] + thick
        offsets = [0, 0]
        if not self.lattice.every:
            known = [0 if code == 15 else last.get(step, 0) for code, last, step in zip(codes, self.last, steps)]
            offsets = [(0, 0, 1, -1)[k] for k in known]
            if self.symbols.bit(self.surprise, 4 * known[0] + known[1], 1):
                value = min(self.symbols.nibble(self.off, 0, 1), 8)
                offsets = [value // 3 - 1, value % 3 - 1]
            for code, last, step, offset in zip(codes, self.last, steps, offsets):
                if code < 15:
                    last[step] = (1, 2, 3)[offset]
        span.low, span.high = steps
        span.bottom, span.top = (height + offset for height, offset in zip(heights, offsets))
        span.codes = [None if code == 15 else (step, offset) for code, step, offset in zip(codes, steps, offsets)]
        span.obstacle = self.symbols.bit(self.kind, 2 * (5 * o + m) + (span.top - span.bottom > 63), 0)
        if self.symbols.trace:
            kind = "obstacle" if span.obstacle else "floor"
            self.symbols.note(f"{kind} {span.bottom} ..= {span.top}; {m} candidates, expected {low}, thickness {thick}")
        check_span(span.bottom, span.top, "P8")
        self.check_apart(before, span)
        self.expected = span.high, span.thickness()
        return span

    @staticmethod
    def choose(low, high, step):
        whole = low // step * step
        low, high = low - whole, high - whole
        if low <= 0 or high >= step:
            return 0
        bit = ((low - 1) ^ high).bit_length() - 1
        return high >> bit << bit


def read_runs(body):
    """The runs of a body of model 2 or 4, and the same as a body of model 1 or 3."""
    from encoding import Bytes  # which needs this module itself

    content = Bytes(body[1:], "P12")
    count = content.varint()
    left = len(body) - 1 - content.at
    need(count % 2 == 0 and 2 <= count <= left, "P12", f"{count} runs in {left} bytes")
    runs = [content.varint() for _ in range(count)]
    need(all(1 <= run <= 1 << 18 for run in runs[1:]) and runs[0] <= 1 << 18, "P12", f"runs {runs}")
    return runs, bytes([body[0] - 1]) + body[1 + content.at :]


def find_lattice(heights, slice_height, moved=0, level_step=None, choose=Page.choose):
    """Step and phase that a writer uses, by the tolerance in quanta; in a page of a level by its step."""
    heights = [(end, height) for end, height in heights if height % SLICE]
    if level_step == THIRD:
        return (THIRD if heights else SLICE) * ONE, 0
    if len(heights) < 32:
        return ONE, 0
    if level_step:
        return fit(heights, [level_step * ONE], choose)
    foot, us_foot = 0.3048, 1200
    units = [0.1, 0.1 * foot, 0.1 * us_foot / 3937, 0.01, 0.005, 0.01 * foot, 0.01 * us_foot / 3937, 0.002, 0.001]
    units += [0.0005, 0.001 * foot, 0.001 * us_foot / 3937, 0.00025, 0.0001]
    scans = [int(unit * 255 / slice_height * ONE + 0.5) for unit in units]
    return fit(heights, steps_within(scans, moved) + scans, choose)


def steps_within(scans, moved):
    """Steps that heights may have been put on within a tolerance of so many quanta."""
    if moved == 0:
        return []
    steps = []
    for step in scans:
        if 2 * ONE <= step <= 255 * ONE:
            most = min(max(moved - 2, 0) * ONE // step + 1, 255 * ONE // step)
            if most <= 6:
                steps += [count * step for count in (most, (most + 1) // 2) if count > 1]
    return steps + [min((moved + 1) // parts, 255) * ONE for parts in (1, 2)]


def fit(heights, steps, choose):
    """The first of `steps` that all heights are on, with the phase that `choose` takes."""
    slack = 1 << 14
    for step in steps:
        if not 2 * ONE <= step <= 255 * ONE:
            continue
        first = None
        for end, height in heights:
            low, high = max((height - end) * ONE - slack, 0), (height - end + 1) * ONE + slack
            if first is None:
                first, left = low, [low, high]
            away = (low - first + step // 2) // step * step
            left = [max(left[0], low - away), min(left[1], high - away)]
            if left[0] > left[1]:
                break
        else:
            return step, choose(*left, step)
    return ONE, 0


# Chapter 1: spans, slices, blocks and words.


def check_span(bottom, top, rule):
    need(0 <= bottom <= top <= TOP and bottom < TOP, rule, f"a span from {bottom} to {top}")


def slices_of(bottom, top):
    """Bits of the slices that a span occupies."""
    first, last = bottom // SLICE, (top - 1) // SLICE
    return (2 << max(first, last)) - (1 << first)


def unions(spans):
    """How many intervals cover `spans`, pairs of bottom and top."""
    count, end = 0, -1
    for bottom, top in sorted(spans):
        count += bottom > end
        end = max(end, top)
    return count


def size_of(columns):
    """Blocks and words of a page."""
    blocks, words = 0, sum(map(len, columns))
    for at in range(64):
        first = at // 8 * 8 * SIDE + at % 8 * 8
        spans = [span for y in range(8) for x in range(8) for span in columns[first + SIDE * y + x]]
        blocks += bool(spans)
        count = sum(unions((span.bottom, span.top) for span in spans if span.obstacle == kind) for kind in (0, 1))
        words += max(count - 4 + 3, 0) // 4 * 4
    return blocks, words

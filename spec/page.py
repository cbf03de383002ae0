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

    def __init__(self, body, trace=None):
        need(body[0] in (1, 2), "P5", f"model {body[0]}")
        self.model, runs = body[0], []
        if self.model == 2:
            runs, body = read_runs(body)
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
        self.symbols.finish()
        need(any(self.columns), "P6", "no pixel is occupied")
        del self.symbols
        self.mark(runs)

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
        if before:
            touching = span.bottom == before.top and span.bottom % SLICE == 0 and span.obstacle != before.obstacle
            need(span.bottom > before.top or touching, "P8", f"spans to {before.top} and from {span.bottom}")
        self.coded_last = span
        return span

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
        lattices = [find_lattice(heights, slice_height, moved, level_step)]
        lattices += [find_lattice(heights, slice_height)] if moved else []
        need(mine in lattices, "P10", f"step and phase are {mine}, should be {lattices[0]}")
        codes = (code for span in spans for code in span.codes)
        for (end, height), code in zip(heights, codes):
            best = self.code_of(end, height)
            need(code == best, "P10", f"height {height} is coded as {code}, should be {best}")

    def code_of(self, end, height):
        for offset in (0, 1, -1):
            if self.lattice.every:
                step = height
            else:
                step = max(self.lattice.next(height - offset - end), 0)
            if step < STEPS and self.lattice.usual(end, step) + offset == height:
                return step, offset
        return None


def read_runs(body):
    """The runs of a body of model 2, and the same as a body of model 1."""
    from encoding import Bytes  # which needs this module itself

    content = Bytes(body[1:], "P12")
    count = content.varint()
    left = len(body) - 1 - content.at
    need(count % 2 == 0 and 2 <= count <= left, "P12", f"{count} runs in {left} bytes")
    runs = [content.varint() for _ in range(count)]
    need(all(1 <= run <= 1 << 18 for run in runs[1:]) and runs[0] <= 1 << 18, "P12", f"runs {runs}")
    return runs, b"\1" + body[1 + content.at :]


def find_lattice(heights, slice_height, moved=0, level_step=None):
    """Step and phase that a writer uses, by the tolerance in quanta; in a page of a level by its step."""
    heights = [(end, height) for end, height in heights if height % SLICE]
    if level_step == THIRD:
        return (THIRD if heights else SLICE) * ONE, 0
    if len(heights) < 32:
        return ONE, 0
    if level_step:
        return fit(heights, [level_step * ONE])
    foot, us_foot = 0.3048, 1200
    units = [0.1, 0.1 * foot, 0.1 * us_foot / 3937, 0.01, 0.005, 0.01 * foot, 0.01 * us_foot / 3937, 0.002, 0.001]
    units += [0.0005, 0.001 * foot, 0.001 * us_foot / 3937, 0.00025, 0.0001]
    scans = [int(unit * 255 / slice_height * ONE + 0.5) for unit in units]
    return fit(heights, steps_within(scans, moved) + scans)


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


def fit(heights, steps):
    """The first of `steps` that all heights are on, with its phase."""
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
            return step, (left[0] + left[1]) // 2 % step
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

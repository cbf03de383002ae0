"""Encoded pages: chapters 1 and 6 of slice-archive.md."""

from bisect import bisect_right

SIDE = 64
TOP = 16320
SLICE = 255
THIRD = SLICE // 3
ONE = 1 << 32  # a quantum, in the unit of steps
STEPS = 1 << 14
PLAIN, MARKED = 3, 4
MOST_PAGE_SPANS = 1 << 18


class Refused(Exception):
    """The archive breaks a rule."""

    def __init__(self, rule, text):
        super().__init__(f"{rule}: {text}")
        self.rule = rule


def need(condition, rule, text):
    if not condition:
        raise Refused(rule, text)


def fold(v):
    return -2 * v - 1 if v < 0 else 2 * v


def unfold(v):
    return -(v + 1 >> 1) if v & 1 else v >> 1


# Section 6.1: the coder. Decoder and encoder have the same methods: each takes the value to write and returns it, or takes
# any and returns the one that it reads.

LOW = 1 << 16
SCALE = 1 << 15
N = [3, 3, 3, 3, 4, 4, 4, 4, 4, 5, 5, 5, 5, 5, 5, 6]
B = [1, 2, 3, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5]


def starts(weights):
    """The first slots of a new symbol model of 16 weights."""
    return [i + 32752 * sum(weights[:i]) // sum(weights) for i in range(17)]


class Symbols:
    """Models of symbols of one name: of each the first slots, and how many symbols it has seen."""

    def __init__(self, name, models):
        self.name, self.models = name, [[first, 0] for first in models]

    def first(self, index):
        return self.models[index][0]

    def learn(self, index, value):
        first, seen = self.models[index]
        rate = N[seen]
        moved = [f + ((i if i <= value else 32752 + i) - f >> rate) for i, f in enumerate(first)]
        self.models[index] = [moved, min(seen + 1, 15)]


class Bits:
    """Models of bits of one name: of each the slots of 1, and how many bits it has seen."""

    def __init__(self, name, ones):
        self.name, self.models = name, [[count, 0] for count in ones]

    def ones(self, index):
        return self.models[index][0]

    def learn(self, index, value):
        ones, seen = self.models[index]
        self.models[index] = [ones + ((32736 if value else 32) - ones >> B[seen]), min(seen + 1, 15)]


class Decoder:
    """Takes symbols from bytes; `trace`, if any, gets each with the state after it, and notes on what they mean."""

    def __init__(self, data, trace=None):
        self.data, self.trace = data, trace
        need(len(data) >= 8, "P6", f"{len(data)} bytes of states")
        self.states = [int.from_bytes(data[at : at + 4], "little") for at in (0, 4)]
        need(min(self.states) >= LOW, "P6", f"states {self.states} at the start")
        self.at, self.raw_bits = 8, 0

    def _take(self, s, start, count):
        state = count * (self.states[s] >> 15) + self.states[s] % SCALE - start
        if state < LOW:
            need(self.at + 2 <= len(self.data), "P6", "shorts are missing")
            state = state << 16 | int.from_bytes(self.data[self.at : self.at + 2], "little")
            self.at += 2
        self.states[s] = state

    def note(self, text):
        if self.trace:
            self.trace(text, False)

    def symbol(self, s, models, index, _=0):
        first = models.first(index)
        value = bisect_right(first, self.states[s] % SCALE, 0, 16) - 1
        return self._coded(s, models, index, value, first[value], first[value + 1] - first[value])

    def bit(self, s, models, index, _=0):
        ones = models.ones(index)
        if self.states[s] % SCALE >= SCALE - ones:
            return self._coded(s, models, index, 1, SCALE - ones, ones)
        return self._coded(s, models, index, 0, 0, SCALE - ones)

    def _coded(self, s, models, index, value, start, count):
        self._take(s, start, count)
        models.learn(index, value)
        if self.trace:
            name = f"{models.name}[{index}]"
            self.trace(f"{name:14} {value:5}  {start:5} {count:5}  {s}  {self.states[s]:08x}", True)
        return value

    def raw(self, n, _=0):
        end = max(len(self.data) - self.raw_bits // 8, 0)
        window = int.from_bytes(self.data[max(end - 5, 0) : end], "big")
        value = window >> self.raw_bits % 8 & ((1 << n) - 1)
        self.raw_bits += n
        if self.trace:
            self.trace(f"{f'raw({n})':14} {value:5}", True)
        return value

    def finish(self):
        used = self.at + (self.raw_bits + 7) // 8
        right = used == len(self.data) and self.states == [LOW, LOW]
        need(right, "P6", f"{used} bytes needed of {len(self.data)}, states {self.states} at the end")
        unused = self.data[self.at] >> self.raw_bits % 8 if self.raw_bits % 8 else 0
        need(unused == 0, "P6", "bits are left")


class Encoder:
    """Collects symbols, and writes their bytes."""

    trace = None

    def __init__(self):
        self.intervals, self.raw_value, self.raw_bits = [], 0, 0

    def note(self, text):
        pass

    def symbol(self, s, models, index, value):
        first = models.first(index)
        self.intervals.append((s, first[value], first[value + 1] - first[value]))
        models.learn(index, value)
        return value

    def bit(self, s, models, index, value):
        ones = models.ones(index)
        self.intervals.append((s, SCALE - ones, ones) if value else (s, 0, SCALE - ones))
        models.learn(index, value)
        return value

    def raw(self, n, value):
        assert 0 <= value < 1 << n
        self.raw_value |= value << self.raw_bits
        self.raw_bits += n
        return value

    def finish(self):
        states, shorts = [LOW, LOW], []
        for s, start, count in reversed(self.intervals):
            state = states[s]
            if state >= count << 17:
                shorts.append(state % LOW)
                state >>= 16
            states[s] = (state // count << 15) + state % count + start
        words = [state.to_bytes(4, "little") for state in states]
        words += [short.to_bytes(2, "little") for short in reversed(shorts)]
        return b"".join(words) + self.raw_value.to_bytes((self.raw_bits + 7) // 8, "big")


# Section 6.2: the step grid.


class StepGrid:
    def __init__(self, step=ONE, phase=0, rounded=0):
        self.step, self.phase, self.rounded = step, phase, rounded
        self.is_quanta = step == ONE

    @classmethod
    def coded(cls, coder, given):
        """The grid that a coder takes or reads."""
        if not coder.raw(1, int(not given.is_quanta)):
            return cls()

        def number(given):
            zeros = coder.raw(6, (given & -given).bit_length() - 1 if given else 40)
            need(zeros <= 40, "P7", f"{zeros} zeros end a number of 40 bits")
            given >>= zeros
            lower = min(40 - zeros, 20)
            low = coder.raw(lower, given & ((1 << lower) - 1))
            return (coder.raw(40 - zeros - lower, given >> lower) << lower | low) << zeros

        step, phase = number(given.step), number(given.phase)
        need(2 * ONE <= step <= SLICE * ONE and phase < step, "P7", f"steps of {step} and phase {phase}")
        return cls(step, phase, coder.raw(1, given.rounded))

    def nominal(self, end, i):
        return (self.phase + i * self.step >> 32) + (0 if self.is_quanta else end)

    def next(self, height):
        return max(-((self.phase - height * ONE) // self.step), 0)

    def code_of(self, end, height):
        """The step that codes a height, and how far it lies off the nominal one; None if no step does."""
        for offset in (0, 1, -1) if self.rounded else (0,):
            i = height if self.is_quanta else self.next(height - offset - end)
            if i < STEPS and self.nominal(end, i) + offset == height:
                return i, offset
        return None


# Section 6.4 and appendix B: tables and models.

LEAST = (
    [0, 1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096, 8192, 0],
    [0, 1, 2, 3, 4, 6, 8, 16, 32, 64, 128, 256, 512, 1024, 4096, 0],
)
BITS = [0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 7], [0, 0, 0, 0, 1, 1, 3, 4, 5, 6, 7, 8, 9, 12, 14, 7]
BOUNDARY = 15
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
OCCUPIED = [2600, 21500, 31000]
FULL = [1500, 1500, 23000, 1500, 1500, 12500, 23000, 12500, 29000]
PIXEL = [3300, 8500, 17000, 19500, 21500, 24000, 28000]


def around(peak):
    return starts([SHAPE[15 + i - peak] for i in range(15)] + [2])


def kind_ones(context):
    o, m, h = context // 10, context // 2 % 5, context % 2
    return min(32768 * (2 * o + 3) // (2 * m + 4) if h else 32768 * (2 * o + 1) // (4 * m + 8), 32000)


def class_of(v):
    return (0, 0, 0, 1, 2, 3, 4, 5, 6, 6)[v.bit_length()] if v.bit_length() < 10 else 7


class Span:
    __slots__ = ("bottom", "top", "obstacle", "low", "high", "inferred")

    def thick(self):
        return self.high - self.low


# Sections 6.3 and 6.4: pixels and spans.


class Walk:
    """Goes over a page with a coder, which reads it, or writes the `given` spans of each pixel."""

    def __init__(self, coder, grid, given=None):
        self.coder, self.grid, self.given = coder, grid, given
        some = 0 if grid.is_quanta else 1
        self.least, self.extra = LEAST[some], BITS[some]
        thin = [starts(THIN_WEIGHTS[some])] * 10
        thickness = thin + [around(THICKNESS_PEAKS[some][c // 10]) for c in range(10, 80)]
        self.count = Symbols("count", [starts(COUNTS[max(c // 4, c % 4, 1) - 1]) for c in range(16)])
        self.bottom = Symbols("bottom", map(around, BOTTOM_PEAKS[some]))
        self.thickness = Symbols("thickness", thickness)
        self.off = Symbols("off", [starts([1] * 16)])
        self.surprise = Bits("surprise", [1024] * 16)
        self.kind = Bits("kind", map(kind_ones, range(50)))
        self.last = {}, {}
        self.expected = None
        self.code_pixels()
        self.columns = [[] for _ in range(SIDE * SIDE)]
        for pixel in range(SIDE * SIDE):
            if self.occupied[pixel]:
                self.code_column(pixel % SIDE, pixel // SIDE)

    def fill_of(self, square):
        """The fill of a square of the page that is to be written."""
        first = square // 8 * 8 * SIDE + square % 8 * 8
        occupied = [bool(self.given[first + SIDE * y + x]) for y in range(8) for x in range(8)]
        return 2 if all(occupied) else int(any(occupied))

    def code_pixels(self):
        sums = [c // 3 + c % 3 for c in range(9)]
        occupied, full = Bits("occupied", [OCCUPIED[min(s, 2)] for s in sums]), Bits("full", FULL)
        pixel = Bits("pixel", [PIXEL[c.bit_count()] for c in range(64)])
        fills = [0] * 64
        for at in range(64):
            fill = self.fill_of(at) if self.given else 0
            context = 3 * (fills[at - 1] if at % 8 else 0) + (fills[at - 8] if at >= 8 else 0)
            if self.coder.bit(0, occupied, context, int(fill > 0)):
                fills[at] = 1 + self.coder.bit(1, full, context, int(fill == 2))
        self.occupied = found = [0] * (SIDE * SIDE)

        def has(px, py):
            return found[SIDE * py + px] if 0 <= px < SIDE and py >= 0 else 0

        places = (-2, 0), (-1, 0), (-1, -1), (0, -1), (1, -1), (0, -2)
        for py in range(SIDE):
            for px in range(SIDE):
                at, fill = SIDE * py + px, fills[py // 8 * 8 + px // 8]
                if fill == 1:
                    context = sum(has(px + x, py + y) << bit for bit, (x, y) in enumerate(places))
                    given = int(bool(self.given[at])) if self.given else 0
                    found[at] = self.coder.bit(px % 2, pixel, context, given)
                else:
                    found[at] = fill // 2

    def code_column(self, px, py):
        def spans(x, y):
            return self.columns[SIDE * y + x] if 0 <= x < SIDE and y >= 0 else []

        self.coder.note(f"pixel ({px}, {py})")
        near = spans(px - 1, py), spans(px, py - 1), spans(px - 1, py - 1), spans(px + 1, py - 1)
        given = self.given[SIDE * py + px] if self.given else []
        context = 4 * min(len(near[0]), 3) + min(len(near[1]), 3)
        number, more = 1, 15
        while more == 15 and number <= 64:
            more = self.coder.symbol(1, self.count, context, max(min(len(given) - number, 15), 0))
            number += more
        need(number <= 64, "P7", f"{number} spans in pixel ({px}, {py})")
        column = self.columns[SIDE * py + px]
        self.expected = self.expected_without_candidates(px, py)
        for at in range(number):
            column.append(self.code_span(near, column[-1] if column else None, given[at] if given else None))

    def expected_without_candidates(self, px, py):
        """Step and thickness of the lowest span of the nearest of four pixels."""
        nearest = None
        west = range(px - 1, -1, -1), (py,)
        for columns, rows in [west] + [((x,), range(py - 1, -1, -1)) for x in (px - 1, px, px + 1) if 0 <= x < SIDE]:
            found = next(((x, y) for y in rows for x in columns if self.columns[SIDE * y + x]), None)
            if found:
                distance = abs(found[0] - px) + py - found[1]
                if nearest is None or distance < nearest[0]:
                    nearest = distance, self.columns[SIDE * found[1] + found[0]][0]
        return (nearest[1].low, nearest[1].thick()) if nearest else (0, 0)

    def code_span(self, near, before, given):
        top = before.top if before else -1
        found = (next((span for span in spans if span.bottom > top), None) for spans in near)
        candidates = [span for span in found if span]
        m, o = len(candidates), sum(span.obstacle for span in candidates)
        lows, thicks = sorted(span.low for span in candidates), sorted(span.thick() for span in candidates)
        e, thick = (lows[m > 2], thicks[m > 2]) if m else self.expected
        x, a = m, m
        if m >= 2:
            low_class, thick_class = class_of(lows[-1] - lows[0]), class_of(thicks[-1] - thicks[0])
            x, a = (8 + low_class if m > 2 else 2 + low_class // 2), 2 + thick_class
        numbers, values, offsets = self.codes_of(given, e, thick) if given else ((0, 0), (0, 0), (0, 0))
        codes = (
            self.coder.symbol(0, self.bottom, x, numbers[0]),
            self.coder.symbol(1, self.thickness, 10 * class_of(abs(thick)) + a, numbers[1]),
        )
        extra = [self.extra[code] for code in codes]
        both = self.coder.raw(sum(extra), values[0] | values[1] << extra[0])
        span = Span()
        span.inferred = False
        span.bottom, span.low = self.height(0, codes[0], both & ((1 << extra[0]) - 1), e)
        span.top, span.high = self.height(1, codes[1], both >> extra[0], span.low + thick)
        if self.grid.rounded:
            self.code_offsets(span, codes, offsets)
        h = int(span.top > span.bottom + 63)
        span.obstacle = self.coder.bit(0, self.kind, 2 * (5 * o + m) + h, given[2] if given else 0)
        if self.coder.trace:
            kind = "obstacle" if span.obstacle else "floor"
            steps = "" if self.grid.is_quanta else f" (steps {span.low}, {span.high})"
            text = f"{kind} {span.bottom} ..= {span.top}{steps}; {m} candidates, expected {e}, thickness {thick}"
            self.coder.note(text)
        check_span(span.bottom, span.top, "P8")
        check_apart(before, span)
        self.expected = span.high, span.thick()
        return span

    def height(self, end, code, value, expected):
        if code == BOUNDARY:
            return SLICE * value, self.grid.next(SLICE * value)
        step = (expected + unfold(self.least[code] + value)) % STEPS
        return self.grid.nominal(end, step), step

    def code_offsets(self, span, codes, given):
        steps = span.low, span.high
        known = [0 if code == BOUNDARY else last.get(step, 0) for code, last, step in zip(codes, self.last, steps)]
        offsets = [(0, 0, 1, -1)[k] for k in known]
        if self.coder.bit(1, self.surprise, 4 * known[0] + known[1], int(list(given) != offsets)):
            value = min(self.coder.symbol(1, self.off, 0, 3 * (given[0] + 1) + given[1] + 1), 8)
            offsets = [value // 3 - 1, value % 3 - 1]
        for code, last, step, offset in zip(codes, self.last, steps, offsets):
            if code != BOUNDARY:
                last[step] = (1, 2, 3)[offset]
        span.bottom += offsets[0]
        span.top += offsets[1]

    def codes_of(self, given, e, thick):
        """Section 6.6: symbol, its bits and offset of both heights of a span that is to be written."""
        numbers, values, offsets, steps = [], [], [], []
        for end, height in enumerate(given[:2]):
            code = self.grid.code_of(end, height)
            if code is None:
                need(height % SLICE == 0, "P10", f"height {height} lies on no step")
                steps.append(self.grid.next(height))
                numbers.append(BOUNDARY)
                values.append(height // SLICE)
                offsets.append(0)
                continue
            expected = steps[0] + thick if end else e
            folded = fold((code[0] - expected + STEPS // 2) % STEPS - STEPS // 2)
            numbers.append(bisect_right(self.least, folded, 0, 15) - 1)
            values.append(folded - self.least[numbers[-1]])
            offsets.append(code[1])
            steps.append(code[0])
        return numbers, values, offsets


class Page:
    """The content of a page: `columns[64 * py + px]` are the spans of a pixel."""

    def __init__(self, body, trace=None):
        need(body[0] in (PLAIN, MARKED), "P5", f"first byte {body[0]}")
        self.body = body
        runs, data = read_runs(body[1:]) if body[0] == MARKED else ([], body[1:])
        decoder = Decoder(data, trace)
        walk = Walk(decoder, StepGrid.coded(decoder, StepGrid()))
        decoder.finish()
        self.columns = walk.columns
        need(any(self.columns), "P6", "no pixel is occupied")
        self.mark(runs)

    def floors(self):
        return [span for column in self.columns for span in column if not span.obstacle]

    # Section 6.5: inferred spans.

    def mark(self, runs):
        floors, at = self.floors(), 0
        need(sum(runs) <= len(floors), "P12", f"runs of {sum(runs)} of {len(floors)} floor spans")
        for number, run in enumerate(runs):
            for span in floors[at : at + run]:
                span.inferred = number % 2 == 1
            at += run

    def runs(self):
        runs = [0]
        for span in self.floors():
            if span.inferred == (len(runs) % 2 == 1):
                runs.append(0)
            runs[-1] += 1
        return runs[: len(runs) // 2 * 2]

    # Section 6.6: the one encoding.

    def check_encoding(self, slice_height, moved=0, of_level=False):
        from encoding import varint  # which needs this module itself

        spans = [span for column in self.columns for span in column]
        heights = [(end, height) for span in spans for end, height in enumerate((span.bottom, span.top))]
        boundaries = [(end, height) for end, height in heights if height % SLICE == 0]
        heights = [(end, height) for end, height in heights if height % SLICE]
        grid = level_grid(heights) if of_level else find_grid(heights, boundaries, slice_height, moved)
        encoder = Encoder()
        StepGrid.coded(encoder, grid)
        Walk(encoder, grid, [[(span.bottom, span.top, span.obstacle) for span in column] for column in self.columns])
        runs = self.runs()
        need(not (of_level and runs), "P10", "inferred spans in a page of a level")
        marks = b"".join(map(varint, [len(runs), *runs])) if runs else b""
        body = bytes([MARKED if runs else PLAIN]) + marks + encoder.finish()
        differs = next((at for at, pair in enumerate(zip(body, self.body)) if pair[0] != pair[1]), len(body))
        need(body == self.body, "P10", f"another encoding of its content from byte {differs} on")


def read_runs(data):
    """The runs at the start of a body's rest, and what follows them."""
    from encoding import Bytes

    content = Bytes(data, "P12")
    count = content.varint()
    left = len(data) - content.at
    need(count % 2 == 0 and 2 <= count <= left, "P12", f"{count} runs in {left} bytes")
    runs = [content.varint() for _ in range(count)]
    need(all(1 <= run <= MOST_PAGE_SPANS for run in runs[1:]) and runs[0] <= MOST_PAGE_SPANS, "P12", f"runs {runs}")
    return runs, data[content.at :]


def level_grid(heights):
    """The grid of a page of a level, by its heights between slices."""
    return StepGrid((THIRD if heights else SLICE) * ONE, 0, 1)


def find_grid(heights, boundaries, slice_height, moved):
    """The grid of a page of an archive, by its heights between slices, others, and the tolerance in quanta."""
    if len(heights) < 32:
        return StepGrid()
    foot, us_foot = 0.3048, 1200
    units = [0.1, 0.1 * foot, 0.1 * us_foot / 3937, 0.01, 0.005, 0.01 * foot, 0.01 * us_foot / 3937, 0.002, 0.001]
    units += [0.0005, 0.001 * foot, 0.001 * us_foot / 3937, 0.00025, 0.0001]
    scanned = [int(unit * 255 / slice_height * ONE + 0.5) for unit in units]
    for step in [SLICE * ONE] + coarse_steps(scanned, moved) + scanned:
        if 2 * ONE <= step <= SLICE * ONE:
            for rounded, below, above in (0, 0, -1), (1, 1 << 14, 1 << 14):
                phase = phase_of(heights, step, below, above)
                if phase is None:
                    continue
                grid, near = StepGrid(step, phase, rounded), StepGrid(step, phase, 1)
                off = [(end, height) for end, height in boundaries if grid.code_of(end, height) is None]
                beside = [(end, height) for end, height in off if near.code_of(end, height)]
                if len(off) <= len(heights) and not beside:
                    return grid
    return StepGrid()


def coarse_steps(scanned, moved):
    """Steps that heights may have been moved to within a tolerance of `moved` quanta."""
    if moved == 0:
        return []
    steps = []
    for step in scanned:
        if 2 * ONE <= step <= SLICE * ONE:
            most = min(max(moved - 2, 0) * ONE // step + 1, SLICE * ONE // step)
            if most <= 6:
                steps += [count * step for count in (most, (most + 1) // 2) if count > 1]
    return steps + [min((moved + 1) // parts, SLICE) * ONE for parts in (1, 2)]


def phase_of(heights, step, below, above):
    """The phase that puts all heights on steps; None if no phase does."""
    first = None
    for end, height in heights:
        start, stop = max((height - end) * ONE - below, 0), (height - end + 1) * ONE + above
        if first is None:
            first, low, high = start, start, stop
        back = (start - first + step // 2) // step * step
        low, high = max(low, start - back), min(high, stop - back)
        if low > high:
            return None
    whole = low // step * step
    low, high = low - whole, high - whole
    if low <= 0 or high >= step:
        return 0
    bit = (low - 1 ^ high).bit_length() - 1
    return high >> bit << bit


# Chapters 1 and 4: spans, slices, blocks and words.


def check_span(bottom, top, rule):
    need(0 <= bottom <= top <= TOP and bottom < TOP, rule, f"a span from {bottom} to {top}")


def check_apart(before, span):
    if before:
        touching = span.bottom == before.top and span.bottom % SLICE == 0 and span.obstacle != before.obstacle
        need(span.bottom > before.top or touching, "P8", f"spans to {before.top} and from {span.bottom}")


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

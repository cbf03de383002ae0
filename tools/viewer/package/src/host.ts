/**
 * The worker's side: drives the engine with bytes and time, and answers the page. It does not depend on `Worker`, so it
 * also runs in the caller's thread.
 */

import { aborted, asError, asFault } from "./fault.js";
import { browser, HttpSource, type Outside } from "./http.js";
import {
  ACTION_CODE,
  ACTION_LENGTH,
  INPUT_LENGTH,
  readAction,
  readCrowd,
  readPaint,
  readPage,
  readSlide,
  readState,
  readStats,
  ROUTE_CODE,
} from "./messages.js";
import type { BatchKind, Call, FromWorker, Note, Open, Routed, Sliding, Step, ToWorker } from "./protocol.js";
import { BlobSource, TailFirst } from "./source.js";
import { NOT_LOADED, SlicewalkError, type Stats } from "./types.js";
import type { Engine } from "./wasm/engine.js";

/** Most bytes of the head of an archive. */
const HEAD = 16 << 10;
/** Rows of a batch answered at a time, and for how long (ms) before other messages are handled. */
const ROWS = 4096;
const BATCH_MS = 4;
const STATS_EVERY = 250;
/** Longest delay of the page requests of steps (ms); walkers that step more often share the streaming work. */
const HINTS_EVERY = 8;
/** Numbers per query of each kind, and per answer. */
const SHAPES = {
  overlaps: [6, 1],
  spheres: [4, 1],
  cylinders: [5, 1],
  sweep: [9, 1],
  cast: [7, 5],
  far: [7, 2],
  floor: [6, 1],
} as const satisfies Record<BatchKind, readonly [number, number]>;
/** Kinds that answer with bytes; of the others the first number of an answer is NaN if pages are missing. */
const OVERLAPS: ReadonlySet<BatchKind> = new Set<BatchKind>(["overlaps", "spheres", "cylinders"]);

export interface Port {
  post(message: FromWorker, transfer: Transferable[]): void;
}

/** Loads the engine; `wasm` comes from the page's options. */
export type LoadEngine = (wasm: string | WebAssembly.Module | undefined) => Promise<EngineModule>;

export interface EngineModule {
  open(fileLength: number, budget: number, requests: number): Engine;
  /** Returns whether the memory is exhausted. */
  isFull(): boolean;
}

interface Waiting {
  resolve(leftOut: number): void;
  reject(error: SlicewalkError): void;
}

export class Host {
  private module: EngineModule | undefined;
  private engine: Engine | undefined;
  private source: TailFirst | undefined;
  private failure: SlicewalkError | undefined;
  private readonly fetches = new Map<number, AbortController>();
  private readonly calls = new Map<number, AbortController>();
  private readonly requests = new Map<number, Waiting>();
  private readonly views: number[] = [];
  private scheduled = false;
  private pumpedAt = Number.NEGATIVE_INFINITY;
  private hintsWait = false;
  /** Requests made for colours, and bytes received. */
  private readonly coloured = [0, 0] as [number, number];
  private timer = new AbortController();
  private readonly life = new AbortController();
  private statsAt = Number.NEGATIVE_INFINITY;
  private statsDue = false;
  private statsWait = false;
  private lastStats = "";
  /** Batches in progress. */
  private batches = 0;
  /** Input of a step, reused. */
  private readonly input = new Float64Array(INPUT_LENGTH);
  /** Wakes the worker without the delay of a timer. */
  private readonly bell = new MessageChannel();

  constructor(
    private readonly port: Port,
    private readonly load: LoadEngine,
    private readonly outside: Outside = browser,
  ) {
    this.bell.port1.onmessage = () => this.pump();
  }

  /** Ends everything and frees the memory, where no worker is terminated. */
  close(): void {
    this.failure ??= aborted();
    for (const gate of [...this.fetches.values(), ...this.calls.values(), this.timer, this.life]) {
      gate.abort();
    }
    this.bell.port1.close();
    const engine = this.engine;
    this.engine = undefined;
    try {
      engine?.free();
    } catch {
      // After a trap the engine cannot be freed.
    }
  }

  receive(message: ToWorker): void {
    if (Array.isArray(message)) {
      this.step(message);
      return;
    }
    if ("note" in message) {
      this.noted(message);
      return;
    }
    const gate = new AbortController();
    this.calls.set(message.id, gate);
    this.answer(message, gate.signal)
      .then(
        ({ value, transfer }) => this.port.post({ id: message.id, value }, transfer),
        (thrown: unknown) => this.port.post({ id: message.id, fault: asFault(this.caught(thrown)) }, []),
      )
      .finally(() => this.calls.delete(message.id));
  }

  private step(message: Step): void {
    const [id, walker, seconds, ...input] = message;
    try {
      this.port.post([id, ...this.stepNow(walker, seconds, input)], []);
    } catch (thrown) {
      this.port.post({ id, fault: asFault(thrown) }, []);
    }
  }

  private noted(message: Note): void {
    if (message.note === "abort") {
      this.calls.get(message.id)?.abort();
      return;
    }
    const engine = this.engine;
    if (!engine || this.failure) {
      return;
    }
    this.guarded(() => {
      switch (message.note) {
        case "look":
          engine.look(message.view, message.at);
          break;
        case "view":
          engine.set_scene(message.view, ...message.settings);
          break;
        case "forget":
          engine.forget(message.name);
          if (this.views.includes(message.name)) {
            this.views.splice(this.views.indexOf(message.name), 1);
          }
          break;
      }
      this.wake();
    });
  }

  private async answer(call: Call, signal: AbortSignal): Promise<{ value: unknown; transfer: Transferable[] }> {
    const plain = (value: unknown) => ({ value, transfer: [] });
    const moved = (array: Float64Array | Uint8Array) => ({ value: array, transfer: [array.buffer as ArrayBuffer] });
    if (call.call === "open") {
      return plain(await this.open(call, signal));
    }
    const engine = this.ready();
    switch (call.call) {
      case "reference": {
        const [start = 0, end = 0] = engine.metadata_range();
        const metadata = (await this.source?.read(start, end, signal)) ?? new Uint8Array();
        return plain(JSON.parse(engine.reference(metadata)));
      }
      case "batch":
        return moved(await this.batch(call.kind, call.rows, call.load, signal));
      case "slide":
        return moved(await this.slide(call, call.load, signal));
      case "load": {
        const leftOut = await this.outcome(engine.load(call.box), signal);
        if (leftOut > 0) {
          throw new SlicewalkError("out-of-memory", `the budget has no room for ${leftOut} pages of this box; give it more`);
        }
        return plain(undefined);
      }
      case "boxes":
        return moved(engine.page_boxes());
      case "map":
        return moved(engine.map(call.area, call.cells));
      case "walker":
        return this.woken(plain(engine.pawn(call.settings, call.at)));
      case "place":
        return this.woken(plain(readState(engine.place(call.walker, call.at))));
      case "crowd":
        return this.woken(plain(engine.crowd(call.settings, call.places)));
      case "step-crowd":
        return moved(this.stepCrowdNow(call.crowd, call.seconds, call.wishes));
      case "route":
        return plain(await this.route(call.walker, call.to, signal));
      case "settings":
        return this.woken(plain(readState(engine.set_pawn(call.walker, call.settings))));
      case "record":
        return plain(readState(engine.record(call.walker)));
      case "file":
        return plain(await this.source?.file(signal));
      case "recording":
        return plain({ steps: engine.recorded_steps(call.walker), path: engine.recorded_path(call.walker) });
      case "view": {
        const view = engine.scene(...call.settings);
        if (call.colours) {
          engine.bring_colours();
        }
        this.views.push(view);
        return plain(view);
      }
    }
  }

  private woken<T>(answer: T): T {
    this.wake();
    return answer;
  }

  private ready(): Engine {
    if (this.failure) {
      throw this.failure;
    }
    if (!this.engine?.is_open()) {
      throw new SlicewalkError("invalid", "the archive is not open yet");
    }
    return this.engine;
  }

  // At once ------------------------------------------------------------------------------------------------------------------

  /** Steps a walker and returns the numbers of its state. */
  stepNow(walker: number, seconds: number, input: readonly number[]): Float64Array {
    return this.atOnce(() => {
      this.input.set(input);
      const state = this.ready().step(walker, seconds, this.input);
      this.stepped(readState(state).missing);
      return state;
    });
  }

  /** Steps a crowd and returns the numbers of its state. */
  stepCrowdNow(crowd: number, seconds: number, wishes: Float64Array): Float64Array {
    return this.atOnce(() => {
      const state = this.ready().step_crowd(crowd, seconds, wishes);
      this.stepped(readCrowd(state).missing);
      return state;
    });
  }

  /** Streams what walkers need next; missing pages block them. */
  private stepped(missing: number): void {
    if (missing > 0 || this.outside.now() - this.pumpedAt >= HINTS_EVERY) {
      this.wake();
    } else {
      this.wakeLater();
    }
  }

  /** Answers a batch from the pages in memory. */
  batchNow(kind: BatchKind, rows: Float64Array): Uint8Array | Float64Array {
    return this.atOnce(() => this.ready()[kind](rows));
  }

  /** Moves a shape among the pages in memory. */
  slideNow({ shape, motion, contacts }: Sliding): Float64Array {
    return this.atOnce(() => this.ready().slide(shape, motion, contacts));
  }

  private atOnce<T>(work: () => T): T {
    try {
      return work();
    } catch (thrown) {
      throw this.caught(thrown);
    } finally {
      this.forgetMissing();
    }
  }

  /** What answers at once misses is not loaded; but what a batch has missed so far, it will load. */
  private forgetMissing(): void {
    // An engine that has trapped takes no calls.
    if (this.batches === 0 && !this.failure) {
      this.engine?.forget_missing();
    }
  }

  // Opening ------------------------------------------------------------------------------------------------------------------

  private opened: Waiting | undefined;

  private async open(call: Open, signal: AbortSignal): Promise<string> {
    const { source } = call;
    const onTrouble = (error: SlicewalkError | null) =>
      this.port.post({ event: "trouble", fault: error && asFault(error) }, []);
    const credentials = call.credentials;
    const options = credentials ? { onTrouble, credentials } : { onTrouble };
    const bytes = new TailFirst(
      typeof source === "string" ? new HttpSource(source, this.outside, options) : new BlobSource(source),
    );
    this.source = bytes;
    // The engine loads while the first bytes arrive.
    const [module] = await Promise.all([this.load(call.wasm), bytes.begin(HEAD, signal)]);
    if (signal.aborted) {
      throw aborted();
    }
    this.module = module;
    this.engine = module.open(bytes.length ?? Number.NaN, call.budgetBytes, call.requests);
    await new Promise<number>((resolve, reject) => {
      this.opened = { resolve, reject };
      signal.addEventListener("abort", () => reject(aborted()), { once: true });
      this.pump();
    });
    return this.engine.info();
  }

  // Routes -------------------------------------------------------------------------------------------------------------------

  private async route(walker: number, to: Float64Array, signal: AbortSignal): Promise<Routed> {
    const route = this.ready().route(walker, to);
    try {
      for (;;) {
        const [code = 0, ...rest] = this.ready().advance_route(route);
        const [request = 0] = rest;
        if (ROUTE_CODE[code] === "not-loaded") {
          if ((await this.outcome(request, signal)) > 0) {
            throw new SlicewalkError("out-of-memory", "the budget has no room for the pages of a route; give it more");
          }
        } else if (ROUTE_CODE[code] === "unfinished") {
          await this.pause();
        } else {
          return { code, points: Float64Array.from(rest) };
        }
        if (signal.aborted) {
          throw aborted();
        }
      }
    } finally {
      this.engine?.forget(route);
    }
  }

  // Batches ------------------------------------------------------------------------------------------------------------------

  private async batch(kind: BatchKind, rows: Float64Array, load: boolean, signal: AbortSignal) {
    const [width, answers] = SHAPES[kind];
    const count = rows.length / width;
    if (!Number.isInteger(count)) {
      throw new SlicewalkError("invalid", `${rows.length} numbers are not rows of ${width}`);
    }
    const out = OVERLAPS.has(kind) ? new Uint8Array(count) : new Float64Array(count * answers);
    this.batches += 1;
    try {
      await this.fill(kind, rows, out, load, signal);
    } catch (thrown) {
      throw this.caught(thrown);
    } finally {
      this.batches -= 1;
      this.forgetMissing();
    }
    return out;
  }

  private async fill(
    kind: BatchKind,
    rows: Float64Array,
    out: Uint8Array | Float64Array,
    load: boolean,
    signal: AbortSignal,
  ): Promise<void> {
    let left: Uint32Array = await this.ask(kind, rows, null, out, signal);
    while (load && left.length > 0) {
      const before = left.length;
      await this.outcome(this.ready().load_missing(), signal);
      this.ready().forget_missing();
      left = await this.ask(kind, rows, left, out, signal);
      if (left.length === before) {
        // Pages evict each other: answer one row alone, keeping all pages that it needs.
        await this.answerAlone(kind, rows, left.slice(0, 1), out, signal);
        left = left.slice(1);
      }
    }
  }

  private async slide({ shape, motion, contacts }: Sliding, load: boolean, signal: AbortSignal): Promise<Float64Array> {
    for (;;) {
      // Only what the move itself misses; batches find what they miss again.
      this.ready().forget_missing();
      const slid = this.ready().slide(shape, motion, contacts);
      const request = load && readSlide(slid).missing > 0 ? this.ready().load_missing() : 0;
      this.ready().forget_missing();
      if (request === 0) {
        return slid;
      }
      if ((await this.outcome(request, signal)) > 0) {
        throw new SlicewalkError("out-of-memory", "the budget has no room for the pages that the move needs; give it more");
      }
    }
  }

  private async answerAlone(
    kind: BatchKind,
    rows: Float64Array,
    row: Uint32Array,
    out: Uint8Array | Float64Array,
    signal: AbortSignal,
  ): Promise<void> {
    this.ready().forget_missing();
    while ((await this.ask(kind, rows, row, out, signal)).length > 0) {
      if ((await this.outcome(this.ready().load_missing(), signal)) > 0) {
        throw new SlicewalkError(
          "out-of-memory",
          `the budget has no room for the pages that row ${row[0]} needs; give it more`,
        );
      }
    }
  }

  /** Answers these rows, or all of them; returns the rows that lack pages. */
  private async ask(
    kind: BatchKind,
    rows: Float64Array,
    which: Uint32Array | null,
    out: Uint8Array | Float64Array,
    signal: AbortSignal,
  ): Promise<Uint32Array> {
    const [width, answers] = SHAPES[kind];
    const count = which?.length ?? rows.length / width;
    const unknown: number[] = [];
    const missing = OVERLAPS.has(kind) ? NOT_LOADED : Number.NaN;
    let begun = this.outside.now();
    for (let first = 0; first < count; first += ROWS) {
      if (this.outside.now() - begun > BATCH_MS) {
        // A long batch lets steps through.
        await this.pause();
        begun = this.outside.now();
      }
      if (signal.aborted) {
        throw aborted();
      }
      const last = Math.min(first + ROWS, count);
      const row = (n: number): number => which?.[n] ?? n;
      let part = rows.subarray(first * width, last * width);
      if (which) {
        part = new Float64Array((last - first) * width);
        for (let n = first; n < last; n++) {
          part.set(rows.subarray(row(n) * width, (row(n) + 1) * width), (n - first) * width);
        }
      }
      const found = this.questioned(() => this.ready()[kind](part), first);
      if (!which) {
        out.set(found, first * answers);
        // Most batches know all answers; checking row by row would take half as long as answering.
        if (!found.includes(missing)) {
          continue;
        }
      }
      for (let n = first; n < last; n++) {
        const at = (n - first) * answers;
        if (which) {
          out.set(found.subarray(at, at + answers), row(n) * answers);
        }
        if (Object.is(found[at], missing)) {
          unknown.push(row(n));
        }
      }
    }
    return Uint32Array.from(unknown);
  }

  /** Row numbers in errors count from the beginning of the batch. */
  private questioned<T>(ask: () => T, first: number): T {
    try {
      return ask();
    } catch (thrown) {
      const error = asError(thrown);
      const message = error.message.replace(/^row (\d+)/, (_, row) => `row ${Number(row) + first}`);
      throw error.kind === "invalid" ? new SlicewalkError("invalid", message) : thrown;
    }
  }

  private pause(): Promise<void> {
    return new Promise((resolve) => {
      const channel = new MessageChannel();
      channel.port1.onmessage = () => {
        channel.port1.close();
        resolve();
      };
      channel.port2.postMessage(0);
    });
  }

  /** Number of pages of a request that did not fit; 0 without a request. */
  private outcome(request: number, signal: AbortSignal): Promise<number> {
    if (request === 0) {
      return Promise.resolve(0);
    }
    return new Promise<number>((resolve, reject) => {
      const abort = () => reject(aborted());
      const done = () => signal.removeEventListener("abort", abort);
      signal.addEventListener("abort", abort, { once: true });
      this.requests.set(request, {
        resolve: (leftOut) => {
          done();
          resolve(leftOut);
        },
        reject: (error) => {
          done();
          reject(error);
        },
      });
      this.wake();
    });
  }

  // The loop -----------------------------------------------------------------------------------------------------------------

  /** Schedules `pump` soon, after messages already queued. */
  private wake(): void {
    if (!this.scheduled) {
      this.scheduled = true;
      this.bell.port2.postMessage(0);
    }
  }

  private wakeLater(): void {
    if (!this.hintsWait && !this.scheduled) {
      this.hintsWait = true;
      this.outside.sleep(HINTS_EVERY, this.life.signal).then(
        () => {
          this.hintsWait = false;
          this.wake();
        },
        () => undefined,
      );
    }
  }

  /** Does what is due now, and at most one long operation. */
  private pump(): void {
    this.scheduled = false;
    this.pumpedAt = this.outside.now();
    const engine = this.engine;
    if (!engine || this.failure) {
      return;
    }
    this.timer.abort();
    this.guarded(() => {
      const wait = this.poll(engine);
      if (engine.decode(this.outside.now()) || this.build(engine) || this.paint(engine)) {
        this.statsDue = true;
        this.wake();
      } else if (wait < Number.POSITIVE_INFINITY) {
        this.timer = new AbortController();
        const { signal } = this.timer;
        this.outside.sleep(Math.max(wait - this.outside.now(), 1), signal).then(
          () => this.wake(),
          () => undefined,
        );
      }
      this.settle(engine);
      this.tell(engine);
    });
  }

  /** Starts and cancels requests as the engine demands; returns when to poll again. */
  private poll(engine: Engine): number {
    const todo = engine.poll(this.outside.now());
    let wait = Number.POSITIVE_INFINITY;
    for (let at = 0; at < todo.length; at += ACTION_LENGTH) {
      const { action, fetch, start, end } = readAction(todo, at);
      const what = ACTION_CODE[action];
      if (what === "cancel") {
        this.fetches.get(fetch)?.abort();
      } else if (what === "wait") {
        wait = start;
      } else {
        void this.fetch(engine, fetch, start, end, what === "fetch-colours");
      }
    }
    for (let report = engine.take_report(); report !== ""; report = engine.take_report()) {
      this.port.post({ event: "trouble", fault: asFault(report) }, []);
    }
    return wait;
  }

  private async fetch(engine: Engine, name: number, start: number, end: number, colours: boolean): Promise<void> {
    const gate = new AbortController();
    this.fetches.set(name, gate);
    try {
      const before = this.source?.requests ?? 0;
      const reading = this.source?.read(start, end, gate.signal);
      // Bytes read ahead cost no request.
      const counts = colours && (this.source?.requests ?? 0) > before;
      this.coloured[0] += counts ? 1 : 0;
      const bytes = await reading;
      this.coloured[1] += counts ? (bytes?.length ?? 0) : 0;
      if (bytes && !this.failure) {
        this.guarded(() => engine.given(name, bytes, this.outside.now()));
      }
    } catch (thrown) {
      if (!gate.signal.aborted) {
        // The source itself retries where that may help.
        this.fail(asError(thrown));
      }
    } finally {
      this.fetches.delete(name);
      this.statsDue = true;
      this.wake();
    }
  }

  /** Builds one page of some view, or drops some. */
  private build(engine: Engine): boolean {
    if (!engine.is_open()) {
      return false;
    }
    for (const view of this.views) {
      const numbers = engine.build(view);
      const ids = engine.take_dropped(view);
      if (ids.length > 0) {
        this.port.post({ event: "drop", view, ids }, [ids.buffer as ArrayBuffer]);
      }
      if (numbers.length > 0) {
        const [positions, normals, attributes] = [engine.take_positions(), engine.take_normals(), engine.take_attributes()];
        const transfer = [positions, normals, attributes].map((array) => array.buffer as ArrayBuffer);
        this.port.post({ event: "page", view, page: readPage(numbers), positions, normals, attributes }, transfer);
        // Next time another view goes first.
        this.views.push(...this.views.splice(this.views.indexOf(view), 1));
        return true;
      }
    }
    return false;
  }

  /** Delivers the colours of one page. */
  private paint(engine: Engine): boolean {
    const numbers = engine.paint();
    if (numbers.length === 0) {
      return false;
    }
    const [cells, colours] = [engine.take_cells(), engine.take_colours()];
    const transfer = [cells, colours].map((array) => array.buffer as ArrayBuffer);
    this.port.post({ event: "colours", paint: readPaint(numbers), cells, colours }, transfer);
    return true;
  }

  /** Resolves finished requests. */
  private settle(engine: Engine): void {
    if (this.opened && engine.is_open()) {
      this.opened.resolve(0);
      this.opened = undefined;
    }
    for (const [request, waiting] of this.requests) {
      try {
        const leftOut = engine.outcome(request);
        if (Number.isNaN(leftOut)) {
          continue;
        }
        waiting.resolve(leftOut);
      } catch (thrown) {
        waiting.reject(asError(thrown));
      }
      this.requests.delete(request);
    }
  }

  /** Posts the statistics, at most four times a second. */
  private tell(engine: Engine): void {
    if (!this.statsDue) {
      return;
    }
    const early = this.statsAt + STATS_EVERY - this.outside.now();
    if (early > 0) {
      if (!this.statsWait) {
        this.statsWait = true;
        this.outside.sleep(early, this.life.signal).then(
          () => {
            this.statsWait = false;
            this.wake();
          },
          () => undefined,
        );
      }
      return;
    }
    this.statsAt = this.outside.now();
    this.statsDue = false;
    const { requests, bytes } = this.source ?? { requests: 0, bytes: 0 };
    const memory = readStats(engine.stats());
    const [colourRequests, colourBytes] = this.coloured;
    const stats: Stats = {
      pages: { resident: memory.residentPages, bytes: memory.residentBytes },
      usedBytes: memory.usedBytes,
      peakBytes: memory.peakBytes,
      budgetBytes: memory.budgetBytes,
      loaded: memory.loaded,
      evicted: memory.evicted,
      missing: memory.missing,
      unbuilt: memory.unbuilt,
      requests,
      bytesLoaded: bytes,
      pending: this.fetches.size,
      colours: { missing: engine.unpainted(), requests: colourRequests, bytes: colourBytes },
    };
    const text = JSON.stringify(stats);
    if (text !== this.lastStats) {
      this.lastStats = text;
      this.port.post({ event: "stats", stats }, []);
    }
  }

  // Failures -----------------------------------------------------------------------------------------------------------------

  private guarded(work: () => void): void {
    try {
      work();
    } catch (thrown) {
      this.fail(this.caught(thrown));
    }
  }

  /** A trap ends the engine; anything else that it throws is an answer. */
  private caught(thrown: unknown): SlicewalkError {
    if (!(thrown instanceof WebAssembly.RuntimeError || thrown instanceof RangeError)) {
      return asError(thrown);
    }
    const full = thrown instanceof RangeError || this.module?.isFull();
    const text = full ? "the browser has no more memory; give a smaller budget" : `the engine stopped: ${String(thrown)}`;
    const error = new SlicewalkError(full ? "out-of-memory" : "engine", text, { cause: thrown });
    this.fail(error);
    return error;
  }

  private fail(error: SlicewalkError): void {
    if (this.failure) {
      return;
    }
    this.failure = error;
    for (const gate of this.fetches.values()) {
      gate.abort();
    }
    for (const waiting of this.requests.values()) {
      waiting.reject(error);
    }
    this.requests.clear();
    if (this.opened) {
      this.opened.reject(error);
      this.opened = undefined;
    } else {
      this.port.post({ event: "failed", fault: asFault(error) }, []);
    }
  }
}

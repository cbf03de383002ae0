/** Bytes by `fetch` with plain `Range` headers, from any static host. */

import { aborted } from "./fault.js";
import type { Source } from "./source.js";
import { SlicewalkError } from "./types.js";

/** Environment of a source; tests provide their own. */
export interface Outside {
  readonly fetch: typeof fetch;
  /** Milliseconds since an arbitrary moment. */
  now(): number;
  /** Resolves after `ms` milliseconds, or rejects when the signal aborts. */
  sleep(ms: number, signal: AbortSignal): Promise<void>;
}

export interface HttpOptions {
  readonly credentials?: RequestCredentials;
  /**
   * Called with the reason when the host cannot be reached, and with null once it can again. Reads keep retrying
   * meanwhile.
   */
  readonly onTrouble?: (error: SlicewalkError | null) => void;
}

/** Longest file that is read whole from hosts that ignore ranges. */
export const WHOLE_LIMIT = 64 << 20;
/** Time without any bytes after which a request is cancelled and repeated (ms). */
const STALLED = 20_000;
/** First pause before a request is repeated (ms); doubles each time. */
const FIRST_PAUSE = 250;
const LONGEST_PAUSE = 5_000;
/** Attempts at the first bytes. Later requests are repeated until the caller cancels them. */
const FIRST_ATTEMPTS = 4;

/** Identifies one version of a file. */
interface Tag {
  readonly etag: string | null;
  readonly modified: string | null;
  readonly total: number | undefined;
}

/** A failure that another attempt may resolve. */
class Passing extends Error {}

export class HttpSource implements Source {
  requests = 0;
  bytes = 0;
  private tag: Tag | undefined;
  private whole: Uint8Array<ArrayBuffer> | undefined;
  private begun = false;
  private troubled = false;

  constructor(
    private readonly url: string,
    private readonly outside: Outside,
    private readonly options: HttpOptions = {},
  ) {}

  get length(): number | undefined {
    return this.tag?.total;
  }

  async read(start: number, end: number, signal: AbortSignal): Promise<Uint8Array<ArrayBuffer>> {
    for (let attempt = 1; ; attempt++) {
      try {
        if (signal.aborted) {
          throw aborted();
        }
        const bytes = this.whole?.slice(start, end) ?? (await this.attempt(start, end, signal));
        this.begun = true;
        if (this.troubled) {
          this.troubled = false;
          this.options.onTrouble?.(null);
        }
        return bytes;
      } catch (thrown) {
        if (signal.aborted) {
          throw aborted();
        }
        if (!(thrown instanceof Passing)) {
          throw thrown;
        }
        const error = new SlicewalkError("network", thrown.message, { cause: thrown.cause });
        if (!this.begun && attempt >= FIRST_ATTEMPTS) {
          throw error;
        }
        if (this.begun) {
          this.troubled = true;
          this.options.onTrouble?.(error);
        }
        await this.outside.sleep(Math.min(FIRST_PAUSE * 2 ** (attempt - 1), LONGEST_PAUSE), signal).catch(() => undefined);
      }
    }
  }

  /** Makes one request, cancelled when it stalls. */
  private async attempt(start: number, end: number, signal: AbortSignal): Promise<Uint8Array<ArrayBuffer>> {
    const gate = new AbortController();
    const giveUp = () => gate.abort();
    signal.addEventListener("abort", giveUp, { once: true });
    const watch = new Watch(this.outside, giveUp);
    try {
      return await this.request(start, end, gate.signal, watch);
    } catch (thrown) {
      if (watch.stalled) {
        throw new Passing(`${this.url}: nothing came for ${STALLED / 1000} s`, { cause: thrown });
      }
      throw thrown;
    } finally {
      watch.end();
      signal.removeEventListener("abort", giveUp);
    }
  }

  private async request(start: number, end: number, signal: AbortSignal, watch: Watch): Promise<Uint8Array<ArrayBuffer>> {
    const response = await this.ask(`bytes=${start}-${end - 1}`, signal);
    watch.alive();
    if (response.status === 206) {
      return this.part(response, start, end, watch);
    }
    if (response.status === 200) {
      this.whole = await this.all(response, watch);
      return this.whole.slice(start, end);
    }
    throw await this.refusal(response);
  }

  async file(signal: AbortSignal): Promise<Blob> {
    if (this.whole) {
      return new Blob([this.whole]);
    }
    try {
      const response = await this.ask("bytes=0-", signal);
      if (!response.ok) {
        throw await this.refusal(response);
      }
      this.check(response, undefined);
      // Browsers keep what does not fit into memory on the disk.
      const blob = await response.blob();
      this.bytes += blob.size;
      this.check(response, blob.size);
      return blob;
    } catch (cause) {
      if (signal.aborted) {
        throw aborted();
      }
      if (cause instanceof SlicewalkError) {
        throw cause;
      }
      const reason = cause instanceof Passing ? cause.message : `${this.url}: the connection broke`;
      throw new SlicewalkError("network", reason, { cause });
    }
  }

  private async ask(range: string, signal: AbortSignal): Promise<Response> {
    this.requests += 1;
    try {
      return await this.outside.fetch(this.url, {
        headers: { Range: range },
        // A cache would queue requests for one file, and could return ranges of an older version.
        cache: "no-store",
        credentials: this.options.credentials ?? "same-origin",
        signal,
      });
    } catch (cause) {
      const way = "the host cannot be reached, or does not let other sites read it (CORS)";
      throw new Passing(`${this.url}: ${way}`, { cause });
    }
  }

  /** Returns why an answer has no bytes of the file. */
  private async refusal(response: Response): Promise<Error> {
    await response.body?.cancel().catch(() => undefined);
    if (response.status === 416) {
      return this.tag ? this.replaced() : new SlicewalkError("not-an-archive", `${this.url}: the file is empty`);
    }
    const status = `${this.url}: the host answers ${response.status} ${response.statusText}`.trimEnd();
    const passing = response.status >= 500 || response.status === 429 || response.status === 408 || this.begun;
    return passing ? new Passing(status) : new SlicewalkError("network", status);
  }

  /** Reads the answer to a range request. */
  private async part(response: Response, start: number, end: number, watch: Watch): Promise<Uint8Array<ArrayBuffer>> {
    // Hidden from other origins unless the host exposes it; then the requested range counts.
    const range = /^bytes (\d+)-(\d+)\/(\d+|\*)$/.exec(response.headers.get("Content-Range") ?? "");
    const total = range?.[3] !== undefined && range[3] !== "*" ? Number(range[3]) : undefined;
    this.check(response, total);
    const length = this.tag?.total;
    const expected = Math.min(end, length ?? end) - start;
    if (range && (Number(range[1]) !== start || Number(range[2]) + 1 !== start + expected)) {
      await response.body?.cancel().catch(() => undefined);
      const found = response.headers.get("Content-Range");
      throw new Passing(
        `${this.url}: the host answers other bytes (expected ${start}-${start + expected - 1}, found ${found})`,
      );
    }
    const bytes = await this.body(response, expected, watch);
    if (bytes.length < expected && (length !== undefined || bytes.length === 0)) {
      throw new Passing(`${this.url}: the answer ended after ${bytes.length} of ${expected} bytes`);
    }
    return bytes;
  }

  /** Reads the whole file from a host without ranges. */
  private async all(response: Response, watch: Watch): Promise<Uint8Array<ArrayBuffer>> {
    const refuse = () =>
      new SlicewalkError(
        "no-ranges",
        `${this.url}: the host ignores ranges, and the file is longer than the ${WHOLE_LIMIT >> 20} MiB that are read whole; ` +
          "use a host that answers Range requests",
      );
    if (Number(response.headers.get("Content-Length") ?? 0) > WHOLE_LIMIT) {
      await response.body?.cancel().catch(() => undefined);
      throw refuse();
    }
    this.check(response, undefined);
    const bytes = await this.body(response, WHOLE_LIMIT, watch).catch((thrown) => {
      throw thrown instanceof Overlong ? refuse() : thrown;
    });
    this.check(response, bytes.length);
    return bytes;
  }

  /** Compares an answer with the first one. */
  private check(response: Response, total: number | undefined): void {
    const tag: Tag = { etag: response.headers.get("ETag"), modified: response.headers.get("Last-Modified"), total };
    const first = this.tag;
    if (!first) {
      this.tag = tag;
      return;
    }
    const differs = first.etag !== null && tag.etag !== null ? first.etag !== tag.etag : differ(first.modified, tag.modified);
    if (differs || differ(first.total, total)) {
      response.body?.cancel().catch(() => undefined);
      throw this.replaced();
    }
    if (first.total === undefined && total !== undefined) {
      this.tag = { ...first, total };
    }
  }

  private replaced(): SlicewalkError {
    return new SlicewalkError("replaced", `${this.url}: the archive was replaced since it was opened; open it again`);
  }

  /** Reads at most `most` bytes of an answer. */
  private async body(response: Response, most: number, watch: Watch): Promise<Uint8Array<ArrayBuffer>> {
    const reader = response.body?.getReader();
    const chunks: Uint8Array[] = [];
    let length = 0;
    try {
      for (;;) {
        const next = await reader?.read();
        if (!next || next.done) {
          break;
        }
        watch.alive();
        this.bytes += next.value.length;
        length += next.value.length;
        if (length > most) {
          await reader?.cancel().catch(() => undefined);
          throw new Overlong(`${this.url}: the host answers more bytes than were asked for`);
        }
        chunks.push(next.value);
      }
    } catch (thrown) {
      throw thrown instanceof Passing ? thrown : new Passing(`${this.url}: the connection broke`, { cause: thrown });
    }
    const bytes = new Uint8Array(length);
    let at = 0;
    for (const chunk of chunks) {
      bytes.set(chunk, at);
      at += chunk.length;
    }
    return bytes;
  }
}

class Overlong extends Passing {}

function differ<T>(a: T | null | undefined, b: T | null | undefined): boolean {
  return a !== null && a !== undefined && b !== null && b !== undefined && a !== b;
}

/** Detects that a request no longer receives anything. */
class Watch {
  stalled = false;
  private last: number;
  private readonly over = new AbortController();

  constructor(
    private readonly outside: Outside,
    private readonly onStall: () => void,
  ) {
    this.last = outside.now();
    void this.run();
  }

  alive(): void {
    this.last = this.outside.now();
  }

  end(): void {
    this.over.abort();
  }

  private async run(): Promise<void> {
    const { signal } = this.over;
    while (!signal.aborted) {
      const left = this.last + STALLED - this.outside.now();
      if (left <= 0) {
        this.stalled = true;
        this.onStall();
        return;
      }
      await this.outside.sleep(left, signal).catch(() => undefined);
    }
  }
}

/** The environment of browsers and of node. */
export const browser: Outside = {
  fetch: (input, init) => fetch(input, init),
  now: () => performance.now(),
  sleep: (ms, signal) =>
    new Promise((resolve, reject) => {
      if (signal.aborted) {
        reject(aborted());
        return;
      }
      const timer = setTimeout(done, ms);
      function done(): void {
        signal.removeEventListener("abort", stop);
        resolve();
      }
      function stop(): void {
        clearTimeout(timer);
        reject(aborted());
      }
      signal.addEventListener("abort", stop, { once: true });
    }),
};

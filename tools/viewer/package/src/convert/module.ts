/** The conversion module: a request as JSON in, an answer as JSON out, files and progress through a host. */

/** Reading was refused, storage is full, a file changed, or there are too many files: negative answers of a host. */
export const REFUSED = -1;
export const FULL = -2;
export const CHANGED = -3;
export const TOO_MANY = -4;

/** What lets a module wait for promises (JavaScript Promise Integration), where an engine has it. */
interface Waiting {
  readonly Suspending?: new (call: (...words: number[]) => number | Promise<number>) => WebAssembly.ImportValue;
  promising?(call: () => void): () => Promise<void>;
}
const waiting = WebAssembly as unknown as Waiting;

/** Whether `read` may return a promise. */
export const CAN_WAIT = waiting.Suspending !== undefined && waiting.promising !== undefined;

/** What the module asks of its surroundings. It waits for `read` only, and only if `CAN_WAIT`. */
export interface ConversionHost {
  /** Fills `into` with the bytes at `offset`; returns how many there were, or a negative answer. */
  read(file: number, offset: number, into: Uint8Array): number | Promise<number>;
  /** Writes `bytes` at `offset` of a temporary file; returns how many were taken, or a negative answer. */
  write(file: number, offset: number, bytes: Uint8Array): number;
  /** Creates an empty temporary file; returns its number, or a negative answer. */
  create(): number;
  remove(file: number): void;
  /** Space for temporary files (bytes). */
  freeBytes(): number;
  stage(name: string, total: number, unit: string): void;
  advance(amount: number): void;
  warn(text: string): void;
  cancelled(): boolean;
}

export interface ConversionRequest {
  readonly task: "preview" | "convert";
  readonly inputs: readonly { name: string; file: number; length: number; beside?: boolean }[];
  readonly options: Readonly<Record<string, unknown>>;
}

export interface ConversionAnswer {
  readonly error?: string;
  readonly parameter?: string | null;
  /** What `sliceconv --dry-run --json` prints. */
  readonly preview?: Record<string, unknown>;
  /** What `sliceconv --json` prints. */
  readonly report?: Record<string, unknown>;
  /** Number and length of the temporary file that holds the archive. */
  readonly file?: number;
  readonly length?: number;
}

interface Exports {
  readonly memory: WebAssembly.Memory;
  allocate(length: number): number;
  run(): void;
  answer(): number;
  answer_len(): number;
}

/** Tells exhausted memory from other errors, such as an access out of bounds, which is a defect. */
export function isOutOfMemory(error: unknown): boolean {
  return error instanceof RangeError || /out of memory|allocation failed/i.test(String(error));
}

/** Runs a request in a fresh instance of the module, so that its memory ends with the request. */
export async function runConversion(
  module: WebAssembly.Module,
  host: ConversionHost,
  request: ConversionRequest,
): Promise<ConversionAnswer> {
  let exports: Exports;
  const bytes = (at: number, length: number): Uint8Array => new Uint8Array(exports.memory.buffer, at >>> 0, length >>> 0);
  const text = (at: number, length: number): string => new TextDecoder().decode(bytes(at, length));
  const read = (file: number, offset: number, at: number, length: number) => host.read(file >>> 0, offset, bytes(at, length));
  const instance = await WebAssembly.instantiate(module, {
    host: {
      read: waiting.Suspending === undefined ? (read as WebAssembly.ImportValue) : new waiting.Suspending(read),
      write: (file: number, offset: number, at: number, length: number) => host.write(file >>> 0, offset, bytes(at, length)),
      create: () => host.create(),
      remove: (file: number) => host.remove(file >>> 0),
      free_bytes: () => host.freeBytes(),
      stage: (at: number, length: number, total: number, unit: number, unitLength: number) =>
        host.stage(text(at, length), total, text(unit, unitLength)),
      advance: (amount: number) => host.advance(amount),
      warn: (at: number, length: number) => host.warn(text(at, length)),
      cancelled: () => (host.cancelled() ? 1 : 0),
    },
  });
  exports = instance.exports as unknown as Exports;
  const written = new TextEncoder().encode(JSON.stringify(request));
  const at = exports.allocate(written.length);
  bytes(at, written.length).set(written);
  await (waiting.promising?.(exports.run) ?? exports.run)();
  return JSON.parse(text(exports.answer(), exports.answer_len())) as ConversionAnswer;
}

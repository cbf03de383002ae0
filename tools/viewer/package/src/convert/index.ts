/**
 * Conversion of scans in the browser. Nothing leaves the machine: inputs are read in parts, temporary data and the archive
 * lie in the browser's private files.
 */

import { absolute } from "../address.js";
import { callable, kindOf, optional, shown } from "../check.js";
import { asError } from "../fault.js";
import { SlicewalkError } from "../types.js";
import type { ConversionAnswer } from "./module.js";
import type { FromConverter, ToConverter } from "./worker.js";

export type { ConversionAnswer, ConversionHost, ConversionRequest } from "./module.js";
export { runConversion } from "./module.js";

/** Options of `slicewalk.convert` in Python, without those about files, threads, parts and warnings. */
export type ConversionOptions = Readonly<Record<string, unknown>>;

export interface ConversionProgress {
  /** What the conversion does, in English, as `sliceconv` says it. */
  readonly stage: string;
  /** Share of the stage that is done, from 0 to 1; 0 while it is unknown. */
  readonly share: number;
}

export interface Converted {
  /** The archive, in the browser's private files until `release`. */
  readonly archive: File;
  /** What `sliceconv --json` prints. */
  readonly report: Record<string, unknown>;
  readonly warnings: readonly string[];
  /** Removes the archive. Otherwise it goes when the page is gone and another conversion begins. */
  release(): void;
}

export interface ConverterOptions {
  /** Makes the worker, where a bundler does not find it. */
  readonly worker?: () => Worker;
  /** Address of the module `convert.wasm`. */
  readonly wasm?: string | URL;
}

/** An input could not be converted; `parameter` is the option that would help, if one would. */
export class ConversionError extends SlicewalkError {
  constructor(
    kind: "invalid" | "engine" | "out-of-memory" | "aborted",
    message: string,
    readonly parameter: string | null = null,
  ) {
    super(kind, message);
    this.name = "ConversionError";
  }
}

/** Whether a file is read only where another one needs it: materials, buffers, textures, reference systems. */
function isBeside({ name }: File): boolean {
  return /\.(mtl|bin|prj|wkt|png|jpe?g|webp|bmp|gif|tga|tiff?|ktx2|dds)$/i.test(name);
}

/** The first of the files that is converted by itself: the archive is named after it. */
export function mainOf(files: readonly File[]): File | undefined {
  return files.find((file) => !isBeside(file)) ?? files[0];
}

/** Root of the folders of all conversions. */
const ROOT = "slicewalk-conversions";
const PATIENCE_MS = 100;
const ATTEMPTS = 50;

async function root(create: boolean): Promise<FileSystemDirectoryHandle | null> {
  try {
    return await (await navigator.storage.getDirectory()).getDirectoryHandle(ROOT, { create });
  } catch {
    return null; // no private files here, or none yet
  }
}

/** Removes a folder; the files of an ended worker stay locked for a moment. */
async function remove(folder: FileSystemDirectoryHandle, name: string): Promise<void> {
  for (let n = 0; n < ATTEMPTS; n++) {
    const failed = await folder.removeEntry(name, { recursive: true }).then(
      () => false,
      (error: unknown) => !(error instanceof DOMException && error.name === "NotFoundError"),
    );
    if (!failed) break;
    await new Promise((resolve) => setTimeout(resolve, PATIENCE_MS));
  }
}

/**
 * Removes what conversions left in the browser's storage whose pages are gone, or once they are gone. Each conversion begins with
 * it, too.
 */
export async function removeLeftovers(): Promise<void> {
  const folder = await root(false);
  if (folder !== null && navigator.locks !== undefined) await sweep(folder, false).catch(() => {});
}

/** Removes folders whose locks nobody holds, now (`ifAvailable`) or when they are released. */
async function sweep(folder: FileSystemDirectoryHandle, ifAvailable: boolean): Promise<void> {
  const names = (folder as unknown as { keys(): AsyncIterable<string> }).keys();
  const sweeps = [];
  for await (const name of names) {
    sweeps.push(
      navigator.locks.request(name, { ifAvailable }, async (lock) => (lock === null ? undefined : remove(folder, name))),
    );
  }
  await Promise.all(sweeps);
}

/** A folder for temporary data that lasts until it is released, or the page is gone. */
async function claim(): Promise<{ name: string | null; release(): void }> {
  const folder = await root(true);
  if (folder === null || navigator.locks === undefined) return { name: null, release: () => {} };
  await sweep(folder, true).catch(() => {});
  const name = crypto.randomUUID();
  let end = (): void => {};
  await new Promise<void>((held) => {
    void navigator.locks.request(name, () => {
      held();
      return new Promise<void>((resolve) => (end = resolve));
    });
  });
  return { name, release: () => void remove(folder, name).then(end) };
}

/** Converts files in a worker of its own, one request at a time. */
export class Converter {
  /** Scans or meshes, and files that meshes name, such as materials; then no two of the files may have the same name. */
  readonly files: readonly File[];
  #worker: Worker | null = null;
  readonly #make: () => Worker;
  readonly #wasm: string;
  /** Cancels the request that runs. */
  #running: AbortController | null = null;

  constructor(files: Iterable<File>, options?: ConverterOptions) {
    const { worker, wasm } = optional(options);
    if (typeof files !== "object" || files === null || !(Symbol.iterator in files)) {
      throw new ConversionError("invalid", `files are a list, such as [file], found ${shown(files)}`);
    }
    this.files = [...files];
    const other = this.files.findIndex((file) => !["File", "Blob"].includes(kindOf(file)));
    if (other >= 0) {
      throw new ConversionError("invalid", `files are of the class File, found ${shown(this.files[other])}`);
    }
    this.#make = worker ?? (() => new Worker(new URL("./worker.js", import.meta.url), { type: "module" }));
    this.#wasm = absolute(wasm ?? new URL("../wasm/convert.wasm", import.meta.url));
  }

  /** What the files are, as `sliceconv --dry-run --json` says it, without a pass over their points. */
  preview(options: ConversionOptions = {}): Promise<Record<string, unknown>> {
    return this.#alone<Record<string, unknown>>(async (cancelled) => {
      const { answer } = await this.#run("preview", options, null, () => {}, [], cancelled);
      return answer.preview ?? {};
    });
  }

  /** Converts the files; the archive has the bytes that `sliceconv` writes with these options. */
  convert(options: ConversionOptions = {}, progress: (now: ConversionProgress) => void = () => {}): Promise<Converted> {
    return this.#alone<Converted>(async (cancelled) => {
      callable(progress, "progress");
      const folder = await claim();
      const warnings: string[] = [];
      try {
        const { answer, archive } = await this.#run("convert", options, folder.name, progress, warnings, cancelled);
        if (archive === null) throw new ConversionError("engine", "the conversion gave no archive");
        return { archive, report: answer.report ?? {}, warnings, release: () => folder.release() };
      } catch (error) {
        // It may hold files of the folder. After `close` it is gone already, and another may serve the next request.
        if (!cancelled.aborted) this.#endWorker();
        folder.release();
        throw error;
      }
    });
  }

  /** Cancels the request that runs, which then fails with `aborted`. Another one may begin at once. */
  close(): void {
    this.#endWorker();
    this.#running?.abort();
    this.#running = null;
  }

  #endWorker(): void {
    this.#worker?.terminate();
    this.#worker = null;
  }

  /** Makes a request if none runs: the worker's answers do not say which one they belong to. */
  async #alone<T>(request: (cancelled: AbortSignal) => Promise<T>): Promise<T> {
    if (this.#running !== null) {
      throw new ConversionError("invalid", "another request of this converter runs; await it first");
    }
    const own = new AbortController();
    this.#running = own;
    try {
      return await request(own.signal);
    } finally {
      if (this.#running === own) this.#running = null;
    }
  }

  #run(
    task: ToConverter["task"],
    options: ConversionOptions,
    folder: string | null,
    progress: (now: ConversionProgress) => void,
    warnings: string[],
    cancelled: AbortSignal,
  ): Promise<{ answer: ConversionAnswer; archive: File | null }> {
    return new Promise((resolve, reject) => {
      const cancel = (): void => reject(new ConversionError("aborted", "the conversion was cancelled"));
      if (cancelled.aborted) {
        cancel();
        return;
      }
      cancelled.addEventListener("abort", cancel);
      let worker: Worker;
      try {
        worker = this.#worker ??= this.#make();
      } catch (error) {
        reject(asError(error));
        return;
      }
      const stopped = (kind: "engine" | "out-of-memory", reason: string): void => {
        worker.terminate();
        if (this.#worker === worker) this.#worker = null;
        reject(new ConversionError(kind, `the conversion stopped: ${reason}`));
      };
      let [stage, total] = ["opening", 0];
      progress({ stage, share: 0 });
      worker.onerror = (event) => {
        event.preventDefault();
        stopped("engine", event.message || "its program cannot be loaded");
      };
      worker.onmessage = ({ data }: MessageEvent<FromConverter>) => {
        // Messages that were under way when the worker was terminated.
        if (cancelled.aborted) return;
        if ("stage" in data) {
          [stage, total] = [data.stage, data.total];
          progress({ stage, share: 0 });
        } else if ("done" in data) {
          progress({ stage, share: total > 0 ? Math.min(1, data.done / total) : 0 });
        } else if ("warning" in data) {
          warnings.push(data.warning);
        } else if ("fault" in data) {
          stopped(data.memory ? "out-of-memory" : "engine", data.fault);
        } else if (data.answer.error !== undefined) {
          reject(new ConversionError("invalid", data.answer.error, data.answer.parameter ?? null));
        } else {
          resolve(data);
        }
      };
      const name = `${(mainOf(this.files)?.name ?? "scan").replace(/(\.copc)?\.[^.]*$/i, "") || "scan"}.slices`;
      // Alone, such files are refused by their names.
      const isAlone = this.files.every(isBeside);
      const inputs = this.files.map((blob) => ({ name: blob.name, blob, beside: !isAlone && isBeside(blob) }));
      try {
        worker.postMessage({ task, inputs, options, wasm: this.#wasm, folder, name } satisfies ToConverter);
      } catch (error) {
        const reason = error instanceof Error ? error.message : String(error);
        reject(new ConversionError("invalid", `files and options cannot be passed to the worker: ${reason}`));
      }
    });
  }
}

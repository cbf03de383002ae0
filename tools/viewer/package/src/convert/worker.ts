/** The worker of a conversion: it is sent one request at a time, and ending it cancels. */

import { BlobFile, MemoryFiles, StoredFiles, type TemporaryFiles } from "./files.js";
import { type ConversionAnswer, type ConversionHost, isOutOfMemory, runConversion } from "./module.js";

export interface ToConverter {
  readonly task: "preview" | "convert";
  readonly inputs: readonly { name: string; blob: Blob; beside: boolean }[];
  readonly options: Readonly<Record<string, unknown>>;
  readonly wasm: string;
  /** Folder of the origin private file system for temporary files; null: in memory. */
  readonly folder: string | null;
  /** Name of the archive. */
  readonly name: string;
}

export type FromConverter =
  | { readonly stage: string; readonly total: number; readonly unit: string }
  | { readonly done: number }
  | { readonly warning: string }
  | { readonly answer: ConversionAnswer; readonly archive: File | null }
  | { readonly fault: string; readonly memory: boolean };

/** Interval of progress (ms). */
const OFTEN_MS = 100;
/** Numbers of temporary files, above those of inputs. */
const TEMPORARY = 1 << 20;

/** Root of the folders of all conversions. */
export const ROOT = "slicewalk-conversions";

const post = (message: FromConverter): void => (self as unknown as Worker).postMessage(message);
let compiled: Promise<WebAssembly.Module> | null = null;

async function compile(url: string): Promise<WebAssembly.Module> {
  const answer = await fetch(url);
  if (!answer.ok) throw new Error(`${url}: the host answered ${answer.status}`);
  return WebAssembly.compile(await answer.arrayBuffer());
}

async function temporary(folder: string | null): Promise<TemporaryFiles> {
  if (folder === null) return new MemoryFiles();
  try {
    const root = await (await navigator.storage.getDirectory()).getDirectoryHandle(ROOT, { create: true });
    return await StoredFiles.open(await root.getDirectoryHandle(folder, { create: true }));
  } catch {
    return new MemoryFiles();
  }
}

async function work({ task, inputs, options, wasm, folder, name }: ToConverter): Promise<void> {
  compiled ??= compile(wasm);
  const module = await compiled;
  const files = task === "convert" ? await temporary(folder) : new MemoryFiles();
  const sources = inputs.map(({ blob }) => new BlobFile(blob));
  let [done, told] = [0, 0];
  const host: ConversionHost = {
    read: (file, offset, into) =>
      file < TEMPORARY ? (sources[file]?.read(offset, into) ?? -1) : files.read(file - TEMPORARY, offset, into),
    write: (file, offset, bytes) => files.write(file - TEMPORARY, offset, bytes),
    create: () => {
      const file = files.create();
      return file < 0 ? file : file + TEMPORARY;
    },
    remove: (file) => files.remove(file - TEMPORARY),
    freeBytes: () => files.freeBytes(),
    stage: (stage, total, unit) => {
      done = 0;
      post({ stage, total, unit });
    },
    advance: (amount) => {
      done += amount;
      const now = performance.now();
      if (now - told < OFTEN_MS) return;
      told = now;
      post({ done });
    },
    warn: (warning) => post({ warning }),
    cancelled: () => false,
  };
  const request = inputs.map(({ name, blob, beside }, file) => ({ name, file, length: blob.size, beside }));
  try {
    const answer = await runConversion(module, host, { task, inputs: request, options });
    const archive = await files.keep(answer.file === undefined ? null : answer.file - TEMPORARY, name);
    post({ answer, archive });
  } catch (error) {
    await files.keep(null, name);
    throw error;
  }
}

self.onmessage = ({ data }: MessageEvent<ToConverter>) => {
  work(data).catch((error: unknown) => {
    const text = error instanceof Error ? error.message : String(error);
    compiled = null;
    post({ fault: text, memory: isOutOfMemory(error) });
  });
};

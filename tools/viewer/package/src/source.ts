/** Sources of an archive's bytes. */

import { SlicewalkError } from "./types.js";

/** Bytes of a file that does not change; if it does, reading fails with `replaced`. */
export interface Source {
  /** Length of the file, once known; undefined if the host does not state it. */
  readonly length: number | undefined;
  /** Number of requests made and bytes received. */
  readonly requests: number;
  readonly bytes: number;
  /** Reads the bytes from `start` up to, but without, `end`; fewer only at the end of a file of unknown length. */
  read(start: number, end: number, signal: AbortSignal): Promise<Uint8Array<ArrayBuffer>>;
  /** All bytes of the file. */
  file(signal: AbortSignal): Promise<Blob>;
}

/** A file chosen by the user. */
export class BlobSource implements Source {
  requests = 0;
  bytes = 0;

  constructor(private readonly blob: Blob) {}

  get length(): number {
    return this.blob.size;
  }

  async read(start: number, end: number, signal: AbortSignal): Promise<Uint8Array<ArrayBuffer>> {
    signal.throwIfAborted();
    this.requests += 1;
    let bytes: Uint8Array<ArrayBuffer>;
    try {
      bytes = new Uint8Array(await this.blob.slice(start, end).arrayBuffer());
    } catch (cause) {
      // Browsers throw this if a file was changed or removed after it was chosen.
      throw new SlicewalkError("replaced", "the file changed since it was opened; open it again", { cause });
    }
    this.bytes += bytes.length;
    return bytes;
  }

  async file(): Promise<Blob> {
    return this.blob;
  }
}

/** Bytes read ahead at the end of a file: footer, metadata and directory of all but large archives. */
const TAIL = 64 << 10;

/**
 * Reads the end of a file in one request and answers later reads of it from memory: footer, directory and metadata are
 * there.
 */
export class TailFirst implements Source {
  private tail: { start: number; bytes: Uint8Array<ArrayBuffer> } | undefined;
  private head: Uint8Array<ArrayBuffer> = new Uint8Array();

  constructor(private readonly source: Source) {}

  get length(): number | undefined {
    return this.source.length;
  }

  get requests(): number {
    return this.source.requests;
  }

  get bytes(): number {
    return this.source.bytes;
  }

  file(signal: AbortSignal): Promise<Blob> {
    return this.source.file(signal);
  }

  /** Reads the first bytes; the answer also reveals the length, if the host states it. */
  async begin(length: number, signal: AbortSignal): Promise<void> {
    this.head = await this.source.read(0, Math.min(length, this.source.length ?? length), signal);
  }

  async read(start: number, end: number, signal: AbortSignal): Promise<Uint8Array<ArrayBuffer>> {
    if (end <= this.head.length) {
      return this.head.slice(start, end);
    }
    const tail = this.tail;
    if (tail && end <= tail.start + tail.bytes.length) {
      if (start >= tail.start) {
        return tail.bytes.slice(start - tail.start, end - tail.start);
      }
      if (tail.start === this.head.length) {
        const bytes = new Uint8Array(end - start);
        bytes.set(this.head.subarray(start));
        bytes.set(tail.bytes.subarray(0, end - tail.start), tail.start - start);
        return bytes;
      }
    }
    if (end !== this.length || end - start > TAIL) {
      return this.source.read(start, end, signal);
    }
    const from = Math.min(start, Math.max(this.head.length, end - TAIL));
    const bytes = await this.source.read(from, end, signal);
    this.tail = { start: from, bytes };
    return bytes.slice(start - from);
  }
}

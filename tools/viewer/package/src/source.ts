/** Where the bytes of an archive come from. */

import { SlicewalkError } from "./types.js";

/** Bytes of a file that does not change; where it did, reading fails with `replaced`. */
export interface Source {
  /** Length of the file, once known; undefined where the host does not say. */
  readonly length: number | undefined;
  /** Requests made, and bytes that came. */
  readonly requests: number;
  readonly bytes: number;
  /** Bytes `start` to `end` (not included), fewer only where the file ends and its length was not known. */
  read(start: number, end: number, signal: AbortSignal): Promise<Uint8Array<ArrayBuffer>>;
}

/** A file that the user chose. */
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
      // What browsers say when a file was changed or removed after it was chosen.
      throw new SlicewalkError("replaced", "the file changed since it was opened; open it again", { cause });
    }
    this.bytes += bytes.length;
    return bytes;
  }
}

/** Bytes read ahead at the end of a file: footer, metadata and directory of all but large archives. */
const TAIL = 64 << 10;

/**
 * Reads the end of a file in one go, and answers from it what is asked for there later: footer, directory and metadata lie
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

  /** Reads the first bytes; with them the length becomes known, where the host says it. */
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

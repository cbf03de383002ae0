/** Inputs and temporary files of a conversion in a worker. */

import { CAN_WAIT, CHANGED, FULL, REFUSED, TOO_MANY } from "./module.js";

/** Bytes read at once from an input, and how many such blocks are kept. */
const BLOCK = 1 << 20;
const BLOCKS = 8;
/** Temporary files that a conversion may have at once: all are opened before, because opening one takes a wait. */
const FILES = 16;
/** Bytes of a piece of a temporary file in memory, and of all of them. */
const PIECE = 1 << 20;
const MEMORY_LIMIT = 768 << 20;

/** Reads a `Blob` at once; only workers can. */
interface ReaderSync {
  readAsArrayBuffer(blob: Blob): ArrayBuffer;
}
declare const FileReaderSync: { new (): ReaderSync };

/** File of the origin private file system, open for this worker alone. */
export interface AccessHandle {
  read(into: Uint8Array, options: { at: number }): number;
  write(bytes: Uint8Array, options: { at: number }): number;
  truncate(length: number): void;
  flush(): void;
  close(): void;
}

/**
 * A file that a person chose, read in blocks. A module that waits for them lets the browser collect the buffers of earlier ones,
 * which it does late while a conversion never returns.
 */
export class BlobFile {
  /** The last one was used last. */
  private readonly blocks: { at: number; bytes: Uint8Array }[] = [];

  constructor(private readonly blob: Blob) {}

  /** Reads at most a block. */
  read(offset: number, into: Uint8Array): number | Promise<number> {
    const length = Math.min(into.length, BLOCK, Math.max(0, this.blob.size - offset));
    for (let at = offset - (offset % BLOCK); at < offset + length; at += BLOCK) {
      const place = this.blocks.findIndex((block) => block.at === at);
      const [block] = place < 0 ? [] : this.blocks.splice(place, 1);
      if (block === undefined) return this.fetch(at, () => this.read(offset, into));
      this.blocks.push(block);
      const from = Math.max(offset, at);
      into.set(block.bytes.subarray(from - at, offset + length - at), from - offset);
    }
    return length;
  }

  /** Keeps the block at `at`, then answers with what `then` returns. */
  private fetch(at: number, then: () => number | Promise<number>): number | Promise<number> {
    const part = this.blob.slice(at, at + BLOCK);
    const keep = (bytes: ArrayBuffer): number | Promise<number> => {
      if (bytes.byteLength < part.size) return CHANGED;
      if (this.blocks.length === BLOCKS) this.blocks.shift();
      this.blocks.push({ at, bytes: new Uint8Array(bytes) });
      return then();
    };
    if (CAN_WAIT) return part.arrayBuffer().then(keep, () => CHANGED);
    let bytes: ArrayBuffer;
    try {
      bytes = new FileReaderSync().readAsArrayBuffer(part);
    } catch {
      return CHANGED;
    }
    return keep(bytes);
  }
}

/** Temporary files. */
export interface TemporaryFiles {
  create(): number;
  remove(file: number): void;
  read(file: number, offset: number, into: Uint8Array): number;
  write(file: number, offset: number, bytes: Uint8Array): number;
  freeBytes(): number;
  /** Keeps one file as a `File` and removes all others. */
  keep(file: number | null, name: string): Promise<File | null>;
}

/** Temporary files in a folder of the origin private file system. */
export class StoredFiles implements TemporaryFiles {
  private readonly free: number[] = [];

  private constructor(
    private readonly folder: FileSystemDirectoryHandle,
    private readonly files: { handle: FileSystemFileHandle; access: AccessHandle }[],
    private readonly room: number,
  ) {
    this.free = files.map((_, number) => number).reverse();
  }

  static async open(folder: FileSystemDirectoryHandle): Promise<StoredFiles> {
    const files = [];
    for (let number = 0; number < FILES; number++) {
      const handle = await folder.getFileHandle(`${number}`, { create: true });
      const access = await (handle as unknown as { createSyncAccessHandle(): Promise<AccessHandle> }).createSyncAccessHandle();
      access.truncate(0);
      files.push({ handle, access });
    }
    const { quota = Infinity, usage = 0 } = await navigator.storage.estimate();
    return new StoredFiles(folder, files, Math.max(0, quota - usage));
  }

  create(): number {
    return this.free.pop() ?? TOO_MANY;
  }

  remove(file: number): void {
    this.files[file]?.access.truncate(0);
    this.free.push(file);
  }

  read(file: number, offset: number, into: Uint8Array): number {
    try {
      return this.files[file]?.access.read(into, { at: offset }) ?? REFUSED;
    } catch {
      return REFUSED;
    }
  }

  write(file: number, offset: number, bytes: Uint8Array): number {
    try {
      const written = this.files[file]?.access.write(bytes, { at: offset }) ?? REFUSED;
      // Chromium throws nothing where the storage is full: it returns a number far above the length.
      return written === bytes.length || written === REFUSED ? written : FULL;
    } catch (error) {
      return error instanceof DOMException && error.name === "QuotaExceededError" ? FULL : REFUSED;
    }
  }

  freeBytes(): number {
    return this.room;
  }

  async keep(file: number | null, name: string): Promise<File | null> {
    let kept: File | null = null;
    for (const [number, { handle, access }] of this.files.entries()) {
      if (number === file) access.flush();
      access.close();
      if (number === file) kept = new File([await handle.getFile()], name);
      else await this.folder.removeEntry(handle.name).catch(() => {});
    }
    return kept;
  }
}

/** Temporary files in memory, where a browser has no private files: pages without TLS, private windows. */
export class MemoryFiles implements TemporaryFiles {
  private readonly files = new Map<number, { pieces: Uint8Array<ArrayBuffer>[]; length: number }>();
  private numbers = 0;
  private used = 0;

  create(): number {
    this.files.set(++this.numbers, { pieces: [], length: 0 });
    return this.numbers;
  }

  remove(file: number): void {
    this.used -= (this.files.get(file)?.pieces.length ?? 0) * PIECE;
    this.files.delete(file);
  }

  read(number: number, offset: number, into: Uint8Array): number {
    const file = this.files.get(number);
    if (file === undefined) return REFUSED;
    const length = Math.min(into.length, Math.max(0, file.length - offset));
    for (let done = 0; done < length;) {
      const at = offset + done;
      const start = at % PIECE;
      const part = (file.pieces[(at - start) / PIECE] as Uint8Array).subarray(start, start + length - done);
      into.set(part, done);
      done += part.length;
    }
    return length;
  }

  write(number: number, offset: number, bytes: Uint8Array): number {
    const file = this.files.get(number);
    if (file === undefined) return REFUSED;
    const end = offset + bytes.length;
    while (file.pieces.length * PIECE < end) {
      if (this.used + PIECE > MEMORY_LIMIT) return FULL;
      try {
        file.pieces.push(new Uint8Array(PIECE));
      } catch {
        return FULL;
      }
      this.used += PIECE;
    }
    for (let done = 0; done < bytes.length;) {
      const at = offset + done;
      const start = at % PIECE;
      const part = bytes.subarray(done, done + PIECE - start);
      (file.pieces[(at - start) / PIECE] as Uint8Array).set(part, start);
      done += part.length;
    }
    file.length = Math.max(file.length, end);
    return bytes.length;
  }

  freeBytes(): number {
    return MEMORY_LIMIT - this.used;
  }

  keep(number: number | null, name: string): Promise<File | null> {
    const file = number === null ? undefined : this.files.get(number);
    this.files.clear();
    if (file === undefined) return Promise.resolve(null);
    const parts = file.pieces.map((piece, n) => piece.subarray(0, Math.min(PIECE, file.length - n * PIECE)));
    return Promise.resolve(
      new File(
        parts.filter((part) => part.length > 0),
        name,
      ),
    );
  }
}

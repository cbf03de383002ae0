// Inputs and temporary files of a conversion on the disk, for tests.

import { closeSync, ftruncateSync, mkdirSync, openSync, readSync, rmSync, statSync, writeSync } from "node:fs";
import { basename, join } from "node:path";

/** Numbers of temporary files begin here. */
const TEMPORARY = 1 << 20;

export class FileHost {
  stages = [];
  warnings = [];
  written = 0;
  #inputs;
  #temporary = new Map();
  #numbers = TEMPORARY;

  /** With `room` bytes for temporary files; inputs count as changed from byte `changed` on. */
  constructor(paths, folder, { room = Infinity, changed = Infinity } = {}) {
    mkdirSync(folder, { recursive: true });
    Object.assign(this, { folder, room, changed });
    this.#inputs = paths.map((path) => openSync(path, "r"));
    this.inputs = paths.map((path, file) => ({ name: basename(path), file, length: statSync(path).size }));
  }

  read(file, offset, into) {
    if (file < TEMPORARY && offset + into.length > this.changed) return -3;
    const descriptor = file < TEMPORARY ? this.#inputs[file] : this.#temporary.get(file);
    return into.length === 0 ? 0 : readSync(descriptor, into, 0, into.length, offset);
  }

  write(file, offset, bytes) {
    this.written += bytes.length;
    if (this.written > this.room) return -2;
    return writeSync(this.#temporary.get(file), bytes, 0, bytes.length, offset);
  }

  create() {
    const number = this.#numbers++;
    const path = join(this.folder, String(number));
    this.#temporary.set(number, openSync(path, "w+"));
    rmSync(path);
    return number;
  }

  remove(file) {
    ftruncateSync(this.#temporary.get(file), 0);
    closeSync(this.#temporary.get(file));
    this.#temporary.delete(file);
  }

  freeBytes() {
    return this.room === Infinity ? 1e12 : Math.max(this.room, 1e9);
  }

  stage(name, total, unit) {
    this.stages.push({ name, total, unit });
  }

  advance() {}

  warn(text) {
    this.warnings.push(text);
  }

  cancelled() {
    return false;
  }

  bytes(file, length) {
    const bytes = new Uint8Array(length);
    for (let done = 0; done < length;) done += readSync(this.#temporary.get(file), bytes, done, length - done, done);
    return bytes;
  }

  close() {
    [...this.#inputs, ...this.#temporary.values()].forEach((descriptor) => closeSync(descriptor));
  }
}

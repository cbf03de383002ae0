/** Checks of arguments, because JavaScript does not check types. What does not fit is refused with `invalid`. */

import { SlicewalkError, type Vec3 } from "./types.js";

/** Most elements of a list, and characters of a text, in a message. */
const SHOWN = 6;
const SHOWN_TEXT = 40;

export function refused(text: string): SlicewalkError {
  return new SlicewalkError("invalid", text);
}

/** Returns the elements of a list of any kind; of anything else none. */
function listed(given: unknown): unknown[] {
  try {
    return typeof given === "object" && given !== null ? Array.from(given as Iterable<unknown>) : [];
  } catch {
    return []; // such as an array whose buffer was transferred elsewhere
  }
}

function word(value: unknown): string {
  switch (typeof value) {
    case "string":
      return JSON.stringify(value.slice(0, SHOWN_TEXT));
    case "function":
      return "a function";
    case "object":
      return value === null ? "null" : Array.isArray(value) ? "an array" : "an object";
    default:
      return String(value);
  }
}

/** Describes a value in a message. */
export function shown(given: unknown): string {
  const all = listed(given);
  if (all.length === 0 && !Array.isArray(given)) {
    return word(given);
  }
  return `[${all.slice(0, SHOWN).map(word).join(", ")}${all.length > SHOWN ? ", …" : ""}]`;
}

/** Returns the numbers of a list of any kind. */
export function numbers(given: unknown, count: 2 | 3, what: string): number[] {
  const all = listed(given);
  if (all.length !== count || !all.every(Number.isFinite)) {
    throw refused(`${what} is ${count === 2 ? "two" : "three"} finite numbers, found ${shown(given)}`);
  }
  return all as number[];
}

export function place(given: unknown, what = "a place"): Vec3 {
  const [x = 0, y = 0, z = 0] = numbers(given, 3, what);
  return [x, y, z];
}

/** Returns x and y, also of a place. */
export function across(given: unknown, what: string): readonly [number, number] {
  const all = listed(given);
  const [x = 0, y = 0] = numbers(all.length === 3 ? all.slice(0, 2) : given, 2, what);
  return [x, y];
}

export function number(given: unknown, what: string): number {
  if (typeof given !== "number" || Number.isNaN(given)) {
    throw refused(`${what} is a number, found ${shown(given)}`);
  }
  return given;
}

/** Returns a number of things; Infinity is the largest one that the engine takes. */
export function count(given: unknown, what: string): number {
  if (typeof given !== "number" || given < 1 || !(Number.isInteger(given) || given === Infinity)) {
    throw refused(`${what} is a whole number from 1 up, found ${shown(given)}`);
  }
  return Math.min(given, 2 ** 32 - 1);
}

/** Returns the time of a step (s). */
export function duration(given: unknown): number {
  if (typeof given !== "number" || !Number.isFinite(given) || given < 0) {
    throw refused(`a step takes seconds, 0 or more, found ${shown(given)}`);
  }
  return given;
}

/** Returns the name of a class, because objects of another frame have another class. */
export function kindOf(given: unknown): string {
  return Object.prototype.toString.call(given).slice(8, -1);
}

/** Returns rows of numbers, one after the other. */
export function rows(given: unknown, what = "rows"): Float64Array {
  const kind = kindOf(given);
  if (kind !== "Float64Array") {
    throw refused(`${what} are a Float64Array, found ${kind}; make one with Float64Array.from`);
  }
  const found = given as Float64Array;
  try {
    found.at(0);
  } catch (cause) {
    throw new SlicewalkError("invalid", `${what} cannot be read; their buffer may have been transferred elsewhere`, { cause });
  }
  return found;
}

/** Returns a copy of rows. */
export function copied(given: unknown, what = "rows"): Float64Array<ArrayBuffer> {
  return rows(given, what).slice();
}

export function object<T extends object>(given: T, what: string): T {
  const found: unknown = given;
  if (typeof found !== "object" || found === null) {
    throw refused(`${what}: expected an object, found ${shown(found)}`);
  }
  return given;
}

/** Returns options, which may be left out. */
export function optional<T extends object>(given: T | null | undefined, what = "options"): T {
  return object(given ?? ({} as T), what);
}

export function callable(given: unknown, what: string): void {
  if (typeof given !== "function") {
    throw refused(`${what} is a function, found ${shown(given)}`);
  }
}

/** Errors in transit between worker, engine and page. */

import { ERROR_KINDS, type ErrorKind, SlicewalkError } from "./types.js";

const KINDS: ReadonlySet<string> = new Set(ERROR_KINDS);

/** An error in a message. */
export interface Fault {
  readonly kind: ErrorKind;
  readonly message: string;
}

/** Converts anything thrown to a `SlicewalkError`; the engine throws texts `kind|message`. */
export function asError(thrown: unknown): SlicewalkError {
  if (thrown instanceof SlicewalkError) {
    return thrown;
  }
  const text = typeof thrown === "string" ? thrown : thrown instanceof Error ? thrown.message : String(thrown);
  const bar = text.indexOf("|");
  const kind = text.slice(0, Math.max(bar, 0));
  if (typeof thrown === "string" && KINDS.has(kind)) {
    return new SlicewalkError(kind as ErrorKind, text.slice(bar + 1));
  }
  if (thrown instanceof DOMException && thrown.name === "AbortError") {
    return new SlicewalkError("aborted", "given up");
  }
  return new SlicewalkError("engine", text, { cause: thrown });
}

export function asFault(thrown: unknown): Fault {
  const { kind, message } = asError(thrown);
  return { kind, message };
}

export function fromFault(fault: Fault): SlicewalkError {
  return new SlicewalkError(fault.kind, fault.message);
}

export function aborted(): SlicewalkError {
  return new SlicewalkError("aborted", "given up");
}

/** The page's side of a worker: calls with answers, notes, events. */

import { refused, shown } from "./check.js";
import { aborted, asError, fromFault } from "./fault.js";
import type { Call, FromWorker, Note, Step, Stepped, ToWorker } from "./protocol.js";
import { SlicewalkError } from "./types.js";

type Event = Extract<FromWorker, { event: string }>;

interface Waiting {
  resolve(value: unknown): void;
  reject(error: SlicewalkError): void;
}

/** What a link needs of a worker. */
export interface WorkerLike {
  onmessage: ((event: MessageEvent<FromWorker>) => void) | null;
  onerror: ((event: ErrorEvent) => void) | null;
  postMessage(message: ToWorker, transfer?: Transferable[]): void;
  terminate(): void;
}

export class Link {
  /** Reason why no more calls are possible. */
  error: SlicewalkError | null = null;
  private readonly waiting = new Map<number, Waiting>();
  private ids = 0;

  constructor(
    private readonly worker: WorkerLike,
    private readonly onEvent: (event: Event) => void,
  ) {
    worker.onmessage = (event: MessageEvent<FromWorker>) => this.receive(event.data);
    worker.onerror = (event) => {
      event.preventDefault?.();
      const text =
        event.message || "it cannot be loaded; is worker.js beside the package's other files, and of type JavaScript?";
      this.end(new SlicewalkError("engine", `the worker failed: ${text}`));
    };
  }

  /** Makes a call; objects in `transfer` move to the worker. */
  call<T>(call: Call, signal?: AbortSignal, transfer: Transferable[] = []): Promise<T> {
    return new Promise<T>((resolve, reject) => {
      if (this.error) {
        throw this.error;
      }
      if (signal !== undefined && signal !== null && typeof signal.addEventListener !== "function") {
        throw refused(`a signal is an AbortSignal, found ${shown(signal)}`);
      }
      if (signal?.aborted) {
        throw aborted();
      }
      const id = ++this.ids;
      const abort = () => {
        this.waiting.delete(id);
        this.note({ note: "abort", id });
        reject(aborted());
      };
      signal?.addEventListener("abort", abort, { once: true });
      const done = () => signal?.removeEventListener("abort", abort);
      this.waiting.set(id, {
        resolve: (value) => {
          done();
          resolve(value as T);
        },
        reject: (error) => {
          done();
          reject(error);
        },
      });
      try {
        this.worker.postMessage({ ...call, id } satisfies ToWorker, transfer);
      } catch (thrown) {
        this.waiting.delete(id);
        done();
        throw asError(thrown);
      }
    });
  }

  /** Makes a step of a walker; resolves to the numbers of its state, after the first one. */
  step(walker: number, seconds: number, input: readonly number[]): Promise<Stepped> {
    return new Promise<Stepped>((resolve, reject) => {
      if (this.error) {
        throw this.error;
      }
      const id = ++this.ids;
      this.waiting.set(id, { resolve: resolve as (value: unknown) => void, reject });
      this.worker.postMessage([id, walker, seconds, ...input] satisfies Step);
    });
  }

  note(note: Note): void {
    if (!this.error) {
      this.worker.postMessage(note);
    }
  }

  /** Stops the worker; pending calls reject with the error. */
  end(error: SlicewalkError): void {
    if (this.error) {
      return;
    }
    this.error = error;
    this.worker.terminate();
    for (const waiting of this.waiting.values()) {
      waiting.reject(error);
    }
    this.waiting.clear();
    if (error.kind !== "aborted") {
      this.onEvent({ event: "failed", fault: { kind: error.kind, message: error.message } });
    }
  }

  private receive(message: FromWorker): void {
    // Messages that were under way when the worker was stopped.
    if (this.error) {
      return;
    }
    if (Array.isArray(message)) {
      const [id = 0] = message;
      const waiting = this.waiting.get(id);
      this.waiting.delete(id);
      waiting?.resolve(message);
      return;
    }
    if ("event" in message) {
      if (message.event === "failed") {
        this.end(fromFault(message.fault));
      } else {
        this.onEvent(message);
      }
      return;
    }
    const waiting = this.waiting.get(message.id);
    this.waiting.delete(message.id);
    if ("fault" in message) {
      waiting?.reject(fromFault(message.fault));
    } else {
      waiting?.resolve(message.value);
    }
  }
}

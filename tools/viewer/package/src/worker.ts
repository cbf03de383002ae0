/** The worker: an engine and its host. */

import { Host } from "./host.js";
import type { FromWorker, ToWorker } from "./protocol.js";
import init, { Engine } from "./wasm/engine.js";

interface Scope {
  onmessage: ((event: MessageEvent<ToWorker>) => void) | null;
  postMessage(message: FromWorker, transfer: Transferable[]): void;
}

const scope = globalThis as unknown as Scope;

const host = new Host({ post: (message, transfer) => scope.postMessage(message, transfer) }, async (wasm) => {
  const { memory } = wasm === undefined ? await init() : await init({ module_or_path: wasm });
  return {
    open: (fileLength, budget, requests) => new Engine(fileLength, budget, requests),
    isFull: () => {
      try {
        memory.grow(1);
        return false;
      } catch {
        return true;
      }
    },
  };
});

scope.onmessage = (event) => host.receive(event.data);

/** The worker: an engine and its host. */

import { loadEngine } from "./engine.js";
import { Host } from "./host.js";
import type { FromWorker, ToWorker } from "./protocol.js";

interface Scope {
  onmessage: ((event: MessageEvent<ToWorker>) => void) | null;
  postMessage(message: FromWorker, transfer: Transferable[]): void;
}

const scope = globalThis as unknown as Scope;

const host = new Host({ post: (message, transfer) => scope.postMessage(message, transfer) }, loadEngine);

scope.onmessage = (event) => host.receive(event.data);

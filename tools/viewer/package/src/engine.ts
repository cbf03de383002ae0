/** Loads the engine into this thread, once. */

import type { EngineModule } from "./host.js";
import init, { Engine } from "./wasm/engine.js";

export async function loadEngine(wasm: string | URL | BufferSource | WebAssembly.Module | undefined): Promise<EngineModule> {
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
}

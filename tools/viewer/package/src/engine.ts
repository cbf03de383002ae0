/** Loads the engine into this thread, once. */

import type { EngineModule } from "./host.js";
import init, { Engine } from "./wasm/engine.js";

/** The instance of all engines, once it is begun. */
let begun: ReturnType<typeof init> | undefined;

export async function loadEngine(wasm: string | URL | BufferSource | WebAssembly.Module | undefined): Promise<EngineModule> {
  // A second instance would replace the first, and engines are addresses in the memory of the instance that made them.
  const loading = (begun ??= wasm === undefined ? init() : init({ module_or_path: wasm }));
  const { memory } = await loading.catch((error: unknown) => {
    if (begun === loading) {
      // The next archive tries again.
      begun = undefined;
    }
    throw error;
  });
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

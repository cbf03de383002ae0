import { defineConfig } from "vite";

// Addresses are relative, so that the built folder works at any path of any host.
export default defineConfig({
  base: "./",
  build: { outDir: "../dist", emptyOutDir: true, target: "es2022", assetsInlineLimit: 0, chunkSizeWarningLimit: 3000 },
  worker: { format: "es" },
  // The package loads its own worker and wasm by address; pre-bundling would lose them.
  optimizeDeps: { exclude: ["slicewalk"] },
});

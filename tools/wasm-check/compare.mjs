// Computes in wasm what `record` computed natively, and names the first word that differs.
//
//   node compare.mjs wasm_check.wasm FOLDER
import { readFileSync } from "node:fs";

const [module, folder] = process.argv.slice(2);
const { instance } = await WebAssembly.instantiate(readFileSync(module), {});
const { memory, archive_of, compute, words } = instance.exports;
const archive = readFileSync(`${folder}/scene.slices`);
const at = archive_of(archive.length);
new Uint8Array(memory.buffer, at, archive.length).set(archive);

let failed = false;
for (const [list, name] of ["answers", "path", "streamed"].entries()) {
  const bytes = readFileSync(`${folder}/${name}.bin`);
  const expected = new BigUint64Array(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
  const count = compute(list);
  // Memory may have grown meanwhile: a view made before would be empty now.
  const found = new BigUint64Array(memory.buffer, words(), count);
  const first = expected.findIndex((word, n) => word !== found[n]);
  if (count !== expected.length || first >= 0) {
    const differs = expected.reduce((sum, word, n) => sum + (word !== found[n]), 0);
    const hex = (word) => word?.toString(16);
    console.error(`${name}: ${count} words, expected ${expected.length}; ${differs} differ, the first is ${first}: ` +
      `${hex(found[first])}, expected ${hex(expected[first])}`);
    failed = true;
  } else {
    console.log(`${name}: ${count} words are the same natively and in wasm`);
  }
}
process.exit(failed ? 1 : 0);

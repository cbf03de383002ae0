export { openArchive } from "./archive.js";
export * from "./types.js";

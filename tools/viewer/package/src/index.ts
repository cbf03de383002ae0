export { openArchive } from "./open.js";
export * from "./types.js";

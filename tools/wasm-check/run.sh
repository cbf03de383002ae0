#!/usr/bin/env bash
# Builds the library for wasm32-unknown-unknown and runs it under node: 100,000 answers, a walk, and a walk on a loader over a
# slow link must be those of the native library, to the last bit. Needs node, clang and a wasm toolchain (toolchain.sh);
# SLICEWALK_WASM_TOOLCHAIN names a folder to keep one in.
set -euo pipefail
cd "$(dirname "$0")/../.."
if ! command -v node >/dev/null; then
    { apt-get update -qq && apt-get install --yes --quiet nodejs; } >&2
fi
target=${CARGO_TARGET_DIR:-$PWD/target}
work=$target/wasm-check
mkdir -p "$work"
cargo run --quiet -p wasm-check --features record --bin record -- "$work"
(
    eval "$(tools/wasm-check/toolchain.sh "${SLICEWALK_WASM_TOOLCHAIN:-$target/wasm-toolchain}")"
    # A folder of its own: another compiler would make cargo build everything else again.
    # shellcheck disable=SC2086
    cargo build --quiet -p wasm-check --lib --release --target wasm32-unknown-unknown --target-dir "$target/wasm" $WASM_FLAGS
)
node tools/wasm-check/compare.mjs "$target/wasm/wasm32-unknown-unknown/release/wasm_check.wasm" "$work"

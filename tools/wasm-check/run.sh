#!/usr/bin/env bash
# run.sh [FOLDER]: builds the library for wasm32-unknown-unknown and runs it under node: 100,000 answers, a walk, and a walk on
# a loader over a slow link must be those of the native library, to the last bit. `record`, the native side, is taken from
# FOLDER if it lies built there.
#
# Needs node, clang and a wasm toolchain (toolchain.sh), and skips, saying so, where one cannot be had.
# SLICEWALK_WASM_TOOLCHAIN names a folder to keep the toolchain in; by default it lies in the target folder.
set -euo pipefail
cd "$(dirname "$0")/../.."
target=${CARGO_TARGET_DIR:-$PWD/target}
work=$target/wasm-check
mkdir -p "$work"

if ! command -v node >/dev/null && ! { apt-get update -qq && apt-get install --yes --quiet nodejs; } >&2; then
    echo "skipped: node is not installed (on Debian: apt-get install nodejs)"
    exit
fi
if ! variables=$(tools/wasm-check/toolchain.sh "${SLICEWALK_WASM_TOOLCHAIN:-$target/wasm-toolchain}"); then
    echo "skipped: no toolchain for wasm (rustup target add wasm32-unknown-unknown)"
    exit
fi
(
    eval "$variables"
    # A folder of its own: another compiler would make cargo build everything else again.
    # shellcheck disable=SC2086
    cargo build --quiet -p wasm-check --lib --release --target wasm32-unknown-unknown --target-dir "$target/wasm" $WASM_FLAGS
)
if [ -n "${1:-}" ]; then
    "$1/record" "$work"
else
    cargo run --quiet -p wasm-check --features record --bin record -- "$work"
fi
node tools/wasm-check/compare.mjs "$target/wasm/wasm32-unknown-unknown/release/wasm_check.wasm" "$work"

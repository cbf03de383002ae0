#!/usr/bin/env bash
# Builds the viewer: the engine as wasm, its package (tools/viewer/package/dist) and the page (tools/viewer/dist). `--engine` leaves
# the page out.
#
# Needs Node.js 20.19 or newer with npm, clang, and a wasm toolchain (toolchain.sh gets one). SLICEWALK_WASM_TOOLCHAIN is
# the folder of that toolchain; by default it is in the target folder.
set -euo pipefail
cd "$(dirname "$0")/../.."
target=${CARGO_TARGET_DIR:-$PWD/target}
viewer=$PWD/tools/viewer

if ! command -v npm >/dev/null && ! { apt-get update -qq && apt-get install --yes --quiet nodejs npm; } >&2; then
    echo "build.sh: npm is not installed; install Node.js 20.19 or newer" >&2
    exit 1
fi
variables=$("$viewer/toolchain.sh" "${SLICEWALK_WASM_TOOLCHAIN:-$target/wasm-toolchain}")
(
    eval "$variables"
    # The smaller zstd decoder, because zstd compresses only directories and metadata.
    export CFLAGS_wasm32_unknown_unknown="-DHUF_FORCE_DECOMPRESS_X1 -DZSTD_FORCE_DECOMPRESS_SEQUENCES_SHORT"
    # A separate folder, because another compiler would make cargo rebuild everything else.
    # shellcheck disable=SC2086
    cargo build --quiet -p slicewalk-engine --lib --profile wasm --target wasm32-unknown-unknown --target-dir "$target/wasm" $WASM_FLAGS
)
(
    cd "$viewer/bindgen"
    CARGO_PROFILE_DEV_DEBUG=0 cargo build --quiet --target-dir "$target/viewer-bindgen"
)
rm -rf "$viewer/package/src/wasm"
"$target/viewer-bindgen/debug/viewer-bindgen" \
    "$target/wasm/wasm32-unknown-unknown/wasm/slicewalk_engine.wasm" "$viewer/package/src/wasm"
# Removes what the compiler leaves: duplicate functions, unused parameters and stores. Passes that shrink the module by
# renaming and reordering locals (-Os, -Oz) make its compressed form larger.
(
    cd "$viewer/bindgen"
    npm ci --no-audit --no-fund --loglevel=error
    node_modules/.bin/wasm-opt -O1 --rse --vacuum --dae-optimizing --simplify-locals-nonesting --code-folding \
        --duplicate-function-elimination --generate-global-effects --vacuum --simplify-globals --remove-unused-module-elements \
        "$viewer/package/src/wasm/engine_bg.wasm" -o "$viewer/package/src/wasm/engine_bg.wasm"
)
size=$(gzip -9 -c "$viewer/package/src/wasm/engine_bg.wasm" | wc -c)
echo "engine: $size bytes compressed"
if [ "$size" -gt 200000 ]; then
    echo "build.sh: the engine is too large: $size bytes compressed (expected at most 200000)" >&2
    exit 1
fi

# npm_package FOLDER: installs the packages of its lock file and builds it.
npm_package() {
    (
        cd "$viewer/$1"
        npm ci --no-audit --no-fund --loglevel=error
        npm run --silent build
    )
}
npm_package package
if [ "${1:-}" != --engine ]; then
    npm_package page
fi

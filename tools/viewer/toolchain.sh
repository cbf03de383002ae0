#!/usr/bin/env bash
# Prints, for `eval`, the variables of a toolchain for wasm32-unknown-unknown and, as WASM_FLAGS, the flags of cargo. Uses
# rustup's target if it is installed; otherwise `tools/rust-source.sh` unpacks a compiler into FOLDER.
#
#   eval "$(tools/viewer/toolchain.sh FOLDER)"
#   cargo build --target wasm32-unknown-unknown $WASM_FLAGS ...
set -euo pipefail
folder=${1:?folder to unpack into}
if rustup target list --installed 2>/dev/null | grep -qx wasm32-unknown-unknown; then
    echo 'export WASM_FLAGS='
    exit
fi
"$(dirname "$0")/../rust-source.sh" "$folder"
lld=$(find "$(rustc --print sysroot)" -name rust-lld | head -1)
cat <<VARIABLES
export CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_LINKER="${lld:-rust-lld}"
export WASM_FLAGS="-Z build-std=std,panic_abort -Z build-std-features=optimize_for_size"
# The engine must be small, so it has no panic messages; no reader would see them.
export CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_RUSTFLAGS="-Zunstable-options -Cpanic=immediate-abort"
VARIABLES

#!/usr/bin/env bash
# Prints, for `eval`, what building for wasm32-unknown-unknown needs: the variables of a toolchain and, as WASM_FLAGS, the
# flags of cargo. The target of rustup is taken if it is installed. Otherwise Debian's packages of rustc and of the source of
# its standard library are unpacked into FOLDER, never installed, so that the system's cargo stays what it is.
#
#   eval "$(tools/viewer/toolchain.sh FOLDER)"
#   cargo build --target wasm32-unknown-unknown $WASM_FLAGS ...
set -euo pipefail
folder=${1:?folder to unpack into}
if ! command -v clang >/dev/null; then
    # It compiles the C code of zstd.
    { apt-get update -qq && apt-get install --yes --quiet clang; } >&2
fi
if rustup target list --installed 2>/dev/null | grep -qx wasm32-unknown-unknown; then
    echo 'export WASM_FLAGS='
    exit
fi
mkdir -p "$folder/deb" "$folder/root"
folder=$(cd "$folder" && pwd)
root=$folder/root
if [ ! -x "$root/usr/bin/rustc" ]; then
    (
        cd "$folder/deb"
        apt-get update -qq
        # Whatever version of Rust the distribution builds its browsers with.
        std=$(apt-cache depends libstd-rust-web-dev | sed -n 's/.*Depends: \(libstd-rust-web-[0-9.]*\)$/\1/p' | head -1)
        llvm=$(apt-cache depends "$std" rustc-web | sed -n 's/.*Depends: \(libllvm[0-9]*\)$/\1/p' | head -1)
        apt-get download rustc-web rust-web-src libstd-rust-web-dev "$std" "$llvm"
        for deb in *.deb; do dpkg -x "$deb" "$root"; done
    ) >&2
fi
lld=$(find "$(rustc --print sysroot)" -name rust-lld | head -1)
cat <<VARIABLES
export LD_LIBRARY_PATH="$root/usr/lib/x86_64-linux-gnu:$root/usr/lib\${LD_LIBRARY_PATH:+:\$LD_LIBRARY_PATH}"
export RUSTC="$root/usr/bin/rustc"
export RUSTC_BOOTSTRAP=1
export CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_LINKER="${lld:-rust-lld}"
export WASM_FLAGS="-Z build-std=std,panic_abort -Z build-std-features=optimize_for_size"
# The engine must be small: no texts of panics, which nobody would read.
export CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_RUSTFLAGS="-Zunstable-options -Cpanic=immediate-abort"
VARIABLES

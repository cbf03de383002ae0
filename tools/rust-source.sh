#!/usr/bin/env bash
# Prints, for `eval`, the variables of a Rust compiler with the source of its standard library, for targets that rustup
# has not installed. Debian's packages are unpacked into FOLDER, never installed, so the system's cargo does not change.
#
#   eval "$(tools/rust-source.sh FOLDER)"
#   cargo build -Z build-std=std,panic_abort --target ...
set -euo pipefail
folder=${1:?folder to unpack into}
mkdir -p "$folder/deb" "$folder/root"
folder=$(cd "$folder" && pwd)
root=$folder/root
if [ ! -x "$root/usr/bin/rustc" ]; then
    (
        cd "$folder/deb"
        apt-get update -qq
        # The version of Rust that the distribution builds its browsers with.
        std=$(apt-cache depends libstd-rust-web-dev | sed -n 's/.*Depends: \(libstd-rust-web-[0-9.]*\)$/\1/p' | head -1)
        llvm=$(apt-cache depends "$std" rustc-web | sed -n 's/.*Depends: \(libllvm[0-9]*\)$/\1/p' | head -1)
        apt-get download rustc-web rust-web-src libstd-rust-web-dev "$std" "$llvm"
        for deb in *.deb; do dpkg -x "$deb" "$root"; done
    ) >&2
fi
cat <<VARIABLES
export LD_LIBRARY_PATH="$root/usr/lib/x86_64-linux-gnu:$root/usr/lib\${LD_LIBRARY_PATH:+:\$LD_LIBRARY_PATH}"
export RUSTC="$root/usr/bin/rustc" RUSTDOC="$root/usr/bin/rustdoc"
export RUSTC_BOOTSTRAP=1
VARIABLES

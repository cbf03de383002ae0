#!/usr/bin/env bash
# Prints, for `eval`, the variables of a toolchain that builds for Linux on another processor and runs its programs under
# qemu and, as LINUX_FLAGS, the flags of cargo. PROCESSOR is `aarch64`, `s390x` (the highest byte of a number first) or
# `i686` (32 bits). Uses rustup's target if it is installed; otherwise `tools/rust-source.sh` unpacks a compiler into
# FOLDER. Installs gcc and qemu by apt-get if they are missing.
#
#   eval "$(tools/linux.sh FOLDER PROCESSOR)"
#   cargo test --target PROCESSOR-unknown-linux-gnu $LINUX_FLAGS ...
set -euo pipefail
folder=${1:?folder to unpack into} processor=${2:?aarch64, s390x or i686}
triple=$processor-unknown-linux-gnu
gcc=$processor-linux-gnu-gcc
emulator=qemu-${processor/i686/i386}
if ! command -v "$gcc" "$emulator" >/dev/null; then
    { apt-get update -qq && apt-get install --yes --quiet "gcc-$processor-linux-gnu" qemu-user; } >&2
fi
flags=
if ! rustup target list --installed 2>/dev/null | grep -qx "$triple"; then
    "$(dirname "$0")/rust-source.sh" "$folder"
    flags="-Z build-std=std,panic_abort,test"
fi
variable=CARGO_TARGET_$(tr a-z- A-Z_ <<<"$triple")
cat <<VARIABLES
export LINUX_FLAGS="$flags"
export ${variable}_LINKER=$gcc CC_${triple//-/_}=$gcc
export ${variable}_RUNNER="$emulator -L /usr/$processor-linux-gnu"
VARIABLES

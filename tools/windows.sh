#!/usr/bin/env bash
# Prints, for `eval`, the variables of a toolchain that builds for x86_64-pc-windows-gnu and runs its programs under wine
# and, as WINDOWS_FLAGS, the flags of cargo. Uses rustup's target if it is installed; otherwise `tools/rust-source.sh`
# unpacks a compiler into FOLDER. Installs mingw-w64 and wine by apt-get if they are missing.
#
#   eval "$(tools/windows.sh FOLDER)"
#   cargo test --target x86_64-pc-windows-gnu $WINDOWS_FLAGS ...
set -euo pipefail
folder=$(mkdir -p "${1:?folder to unpack into}" && cd "$1" && pwd)
if ! command -v x86_64-w64-mingw32-gcc >/dev/null || [ ! -x /usr/lib/wine/wine64 ]; then
    { apt-get update -qq && apt-get install --yes --quiet gcc-mingw-w64-x86-64 wine64; } >&2
fi
# Rust's standard library gets random numbers from a DLL that wine in Debian 12 lacks; this one has its only function.
if [ ! -f "$folder/wine/bcryptprimitives.dll" ]; then
    mkdir -p "$folder/wine"
    cat > "$folder/wine/random.c" <<'C'
#include <windows.h>
BOOLEAN NTAPI SystemFunction036(PVOID bytes, ULONG count);
__declspec(dllexport) BOOL WINAPI ProcessPrng(PBYTE bytes, SIZE_T count) {
    for (; count; ) {
        ULONG part = count > 1 << 20 ? 1 << 20 : (ULONG)count;
        if (!SystemFunction036(bytes, part)) return FALSE;
        bytes += part;
        count -= part;
    }
    return TRUE;
}
C
    x86_64-w64-mingw32-gcc -shared -o "$folder/wine/bcryptprimitives.dll" "$folder/wine/random.c" -ladvapi32
fi
flags=
if ! rustup target list --installed 2>/dev/null | grep -qx x86_64-pc-windows-gnu; then
    "$(dirname "$0")/rust-source.sh" "$folder"
    flags="-Z build-std=std,panic_abort,test"
fi
cat <<VARIABLES
export WINDOWS_FLAGS="$flags"
export CARGO_TARGET_X86_64_PC_WINDOWS_GNU_LINKER=x86_64-w64-mingw32-gcc
export CARGO_TARGET_X86_64_PC_WINDOWS_GNU_RUNNER=/usr/lib/wine/wine64
export WINEPREFIX="$folder/wine/prefix" WINEDEBUG=-all WINEPATH="Z:$folder/wine"
VARIABLES

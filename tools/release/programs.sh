# Programs for each system, and packages for Debian; read by `run`.

# As they are shipped: with the page and the clients of web servers and object stores, without what only a debugger reads.
programs=(-p sliceconv -p slicetool --features sliceconv/clouds,slicetool/clouds,slicetool/page --profile dist)
export CARGO_PROFILE_DIST_DEBUG=false CARGO_PROFILE_DIST_STRIP=symbols

# page_for_programs: prints the folder of the page that the programs contain.
page_for_programs() {
    local archive
    from_folder "slicewalk-$version-licences.txt" licences >/dev/null
    archive=$(from_folder "slicewalk-$version-page.tar.gz" page)
    rm -rf "$tools/page" && mkdir -p "$tools/page"
    tar -xzf "$archive" -C "$tools/page" --strip-components=1
    echo "$tools/page"
}

# nameless TRIPLE [FLAG...]: exports the compiler's flags for a target, those given and some by which programs do not name folders of
# the machine that builds them: the same commit gives the same bytes everywhere.
nameless() {
    local triple=$1 folder
    shift
    cargo fetch --quiet
    for folder in "${CARGO_HOME:-$HOME/.cargo}"/registry/src/*/ "$tools/rust/root/" "$target/"; do
        set -- "$@" "--remap-path-prefix=$folder="
    done
    export "CARGO_TARGET_$(tr a-z- A-Z_ <<<"$triple")_RUSTFLAGS=$*"
}

# static TRIPLE: builds static programs with musl, by zig's C compiler. If rustup has not installed the target, the standard library
# is built from source.
static() {
    local triple=$1 bin page flags=()
    bin=$(python_tools ziglang==0.15.2 cargo-zigbuild==0.24.0)
    page=$(page_for_programs)
    (
        export PATH=$bin:$PATH SLICEWALK_PAGE=$page
        export CARGO_ZIGBUILD_CACHE_DIR=$tools/zig ZIG_GLOBAL_CACHE_DIR=$tools/zig ZIG_LOCAL_CACHE_DIR=$tools/zig
        if ! rustup target list --installed 2>/dev/null | grep -qx "$triple"; then
            eval "$("$root/tools/rust-source.sh" "$tools/rust")"
            flags=(-Z build-std=std,panic_abort)
            # The source comes without musl's start files, which zig has.
            nameless "$triple" -Clink-self-contained=no
        else
            nameless "$triple"
        fi
        cargo zigbuild --quiet --target "$triple" --target-dir "$target/release-programs" "${flags[@]}" "${programs[@]}"
    )
}

# described FOLDER PROGRAMS: adds manual pages, completions and licences, written by the programs of this system in PROGRAMS.
described() {
    local to=$1 bin=$2 shell
    mkdir -p "$to"/{man,completions}
    for shell in bash zsh fish; do
        "$bin/sliceconv" --completions "$shell" >"$to/completions/sliceconv.$shell"
        "$bin/slicetool" completions "$shell" >"$to/completions/slicetool.$shell"
    done
    "$bin/sliceconv" --man >"$to/man/sliceconv.1"
    "$bin/slicetool" man "$to/man" >/dev/null
    cp README.md CHANGELOG.md SECURITY.md LICENSE-MIT LICENSE-APACHE "$to"
    cp "$(from_folder "slicewalk-$version-licences.txt" licences)" "$to/THIRD-PARTY-LICENCES.txt"
}

# tried NAME COMMAND...: runs the programs, which COMMAND calls by their names: the demo, then a conversion of its scan, a check, an
# export and a site. Every system must make the same archive.
tried() {
    local name=$1 folder=$2 sum
    shift 2
    "$@" slicetool demo >/dev/null
    "$@" sliceconv demo-out/house.laz -o scan.slices --pixel 0.05 --quiet
    "$@" slicetool verify scan.slices
    "$@" slicetool export scan.slices -o scan.ply
    "$@" slicetool site scan.slices -o site >/dev/null
    [ -s "$folder/scan.ply" ] && [ -s "$folder/site/index.html" ] || fail "$name: no export or no site"
    sum=$(sha256sum <"$folder/scan.slices")
    [ "${archive_sum:=$sum}" = "$sum" ] || fail "$name: the archive differs from that of the other systems"
}

# in_root FOLDER COMMAND...: runs a program with FOLDER as the root, where nothing else is.
in_root() {
    local fresh=$1
    shift
    mkdir -p "$fresh"/{tmp,home}
    env -i PATH=/bin:/usr/bin TMPDIR=/tmp unshare --map-root-user --root="$fresh" --wd=/home "$@"
}

# for_linux TRIPLE NAME [QEMU]: packs static programs, unpacks them in an empty root and tries them there.
for_linux() {
    local name=$2 qemu=${3:-} built=$target/release-programs/$1/dist fresh=$work/root-$2
    mkdir -p "$work/$name/bin" "$fresh"
    cp "$built/sliceconv" "$built/slicetool" "$work/$name/bin"
    file_is_static "$work/$name/bin/sliceconv" "$work/$name/bin/slicetool"
    described "$work/$name" "${native:-$work/$name/bin}"
    tarred "$out/$name.tar.gz" "$work" "$name"
    tar -xzf "$out/$name.tar.gz" -C "$fresh" --strip-components=1
    if [ -n "$qemu" ]; then
        cp "$qemu" "$fresh/qemu"
        emulated() { in_root "$fresh" /qemu "/bin/$1" "${@:2}"; }
        tried "$name" "$fresh/home" emulated
    else
        tried "$name" "$fresh/home" in_root "$fresh"
    fi
}

# file_is_static FILE...: fails if a program names an interpreter, that is, needs libraries of the system.
file_is_static() {
    local file
    for file in "$@"; do
        ! readelf --program-headers --wide "$file" | grep -q INTERP || fail "$file is not static"
    done
}

make_linux() {
    static x86_64-unknown-linux-musl
    for_linux x86_64-unknown-linux-musl "slicewalk-$version-x86_64-linux"
}

make_arm() {
    needs qemu-aarch64-static qemu-user-static
    local native=$work/native
    mkdir -p "$native"
    tar -xzf "$(from_folder "slicewalk-$version-x86_64-linux.tar.gz" linux)" -C "$native" --strip-components=1
    native=$native/bin
    static aarch64-unknown-linux-musl
    for_linux aarch64-unknown-linux-musl "slicewalk-$version-aarch64-linux" "$(command -v qemu-aarch64-static)"
}

make_windows() {
    local name=slicewalk-$version-x86_64-windows native=$work/native-windows triple=x86_64-pc-windows-gnu fresh=$work/windows
    local variables page
    mkdir -p "$native" "$work/$name" "$fresh/home"
    tar -xzf "$(from_folder "slicewalk-$version-x86_64-linux.tar.gz" linux)" -C "$native" --strip-components=1
    variables=$("$root/tools/windows.sh" "$tools/rust")
    page=$(page_for_programs)
    (
        eval "$variables"
        export SLICEWALK_PAGE=$page
        nameless "$triple"
        # shellcheck disable=SC2086
        cargo build --quiet --target "$triple" --target-dir "$target/release-programs" $WINDOWS_FLAGS "${programs[@]}"
    )
    cp "$target/release-programs/$triple/dist"/{sliceconv,slicetool}.exe "$work/$name"
    described "$work/$name" "$native/bin"
    rm -r "$work/$name/man"
    (cd "$work" && python3 - "$out/$name.zip" "$name" "$commit_time" <<'END'
# Names in order, one time: the same commit gives the same bytes.
import pathlib, sys, time, zipfile

path, name, seconds = sys.argv[1:]
when = time.gmtime(int(seconds))[:6]
with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as packed:
    for file in sorted(pathlib.Path(name).rglob("*")):
        if file.is_file():
            entry = zipfile.ZipInfo(file.as_posix(), when)
            entry.external_attr = 0o644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            packed.writestr(entry, file.read_bytes())
END
    )
    python3 -m zipfile -e "$out/$name.zip" "$fresh"
    in_wine() (
        eval "$(grep -E 'WINE|RUNNER' <<<"$variables")"
        cd "$fresh/home"
        "$CARGO_TARGET_X86_64_PC_WINDOWS_GNU_RUNNER" "$fresh/$name/$1.exe" "${@:2}"
    )
    tried "$name" "$fresh/home" in_wine
}

# deb NAME ARCHITECTURE [QEMU]: a package for Debian of the programs in NAME, installed and removed in an empty root.
deb() {
    local name=$1 architecture=$2 qemu=${3:-} tree=$work/deb-$2/tree from=$work/deb-$2/from fresh=$work/deb-$2/root
    local package=$out/slicewalk_${version}_$architecture.deb doc page
    doc=$tree/usr/share/doc/slicewalk
    mkdir -p "$from" "$tree/usr/bin" "$tree/DEBIAN" "$doc" "$tree/usr/share/man/man1"
    tar -xzf "$out/$name.tar.gz" -C "$from" --strip-components=1
    install "$from"/bin/* "$tree/usr/bin"
    for page in "$from"/man/*.1; do
        gzip -n9 <"$page" >"$tree/usr/share/man/man1/$(basename "$page").gz"
    done
    for program in sliceconv slicetool; do
        install -D -m 644 "$from/completions/$program.bash" "$tree/usr/share/bash-completion/completions/$program"
        install -D -m 644 "$from/completions/$program.zsh" "$tree/usr/share/zsh/vendor-completions/_$program"
        install -D -m 644 "$from/completions/$program.fish" "$tree/usr/share/fish/vendor_completions.d/$program.fish"
    done
    install -m 644 "$from/README.md" "$from/SECURITY.md" "$doc"
    gzip -n9 <"$from/CHANGELOG.md" >"$doc/changelog.gz"
    gzip -n9 <"$from/THIRD-PARTY-LICENCES.txt" >"$doc/THIRD-PARTY-LICENCES.txt.gz"
    { echo "Slicewalk: MIT or Apache-2.0, at your choice." && cat "$from/LICENSE-MIT" "$from/LICENSE-APACHE"; } >"$doc/copyright"
    cat >"$tree/DEBIAN/control" <<CONTROL
Package: slicewalk
Version: $version
Architecture: $architecture
Maintainer: The Slicewalk developers <slicewalk@localhost>
Installed-Size: $(du -k -s --apparent-size "$tree/usr" | cut -f1)
Section: science
Priority: optional
Description: walk in laser scans too large for memory
 sliceconv converts laser scans, meshes and splats of any size into slice
 archives in bounded memory. slicetool inspects, queries, walks, exports and
 serves archives.
CONTROL
    (cd "$tree" && find usr -type f -printf '%P\0' | sort -z | sed -z 's|^|usr/|' | xargs -0 md5sum >DEBIAN/md5sums)
    chmod -R go=rX,u=rwX "$tree"
    dpkg-deb --root-owner-group -Zxz --build "$tree" "$package" >/dev/null
    mkdir -p "$fresh/var/lib/dpkg"/{info,updates}
    touch "$fresh/var/lib/dpkg/status" "$fresh/var/lib/dpkg/available"
    local dpkg=(unshare --map-root-user dpkg --root="$fresh" --log=/dev/null --force-architecture --force-not-root)
    "${dpkg[@]}" --install "$package" >/dev/null
    if [ -n "$qemu" ]; then
        cp "$qemu" "$fresh/qemu"
        emulated() { in_root "$fresh" /qemu "/usr/bin/$1" "${@:2}"; }
        tried "$(basename "$package")" "$fresh/home" emulated
    else
        tried "$(basename "$package")" "$fresh/home" in_root "$fresh"
    fi
    "${dpkg[@]}" --remove slicewalk >/dev/null
    [ -z "$(find "$fresh" -path "$fresh/usr/*" -type f)" ] || fail "$package leaves files behind when it is removed"
}

make_deb() {
    command -v dpkg-deb >/dev/null || fail "dpkg-deb is missing; install the package dpkg"
    from_folder "slicewalk-$version-x86_64-linux.tar.gz" linux >/dev/null
    deb "slicewalk-$version-x86_64-linux" amd64
    if [ -f "$out/slicewalk-$version-aarch64-linux.tar.gz" ]; then
        needs qemu-aarch64-static qemu-user-static
        deb "slicewalk-$version-aarch64-linux" arm64 "$(command -v qemu-aarch64-static)"
    fi
}

# Shared by the parts of a release; read by `run`.

# needs PROGRAM PACKAGE: installs a package of Debian if the program is missing.
needs() {
    command -v "$1" >/dev/null && return
    say "installs $2, which has $1"
    { apt-get update -qq && apt-get install --yes --quiet --no-install-recommends "$2"; } >&2 ||
        fail "$1 is missing; install it, on Debian with: apt-get install $2"
}

# from_folder PATTERN PART: prints the file of another part that matches in the folder of the release.
from_folder() {
    local found
    found=$(find "$out" -maxdepth 1 -name "$1" | head -1)
    [ -n "$found" ] || fail "$1 is not in $out; make the part $2 first"
    echo "$found"
}

# cargo_tool NAME VERSION [OPTION...]: installs a subcommand of cargo in the target folder and prints its path.
cargo_tool() {
    if ! grep -qF "\"$1 $2 " "$tools/.crates.toml" 2>/dev/null; then
        # Optimised: an unoptimised cargo-about takes many minutes to recognise licences.
        cargo install --quiet --locked --root "$tools" --target-dir "$tools/target" "$1@$2" "${@:3}" >&2
        rm -rf "$tools/target"
    fi
    echo "$tools/bin/$1"
}

# python_tools PACKAGE...: a virtual environment in the target folder with these packages; prints its folder of programs.
python_tools() {
    [ -x "$tools/venv/bin/python" ] || python3 -m venv "$tools/venv" >&2
    "$tools/venv/bin/pip" install --quiet --disable-pip-version-check "$@" >&2
    echo "$tools/venv/bin"
}

# tarred FILE FOLDER NAME: packs FOLDER/NAME. The same commit gives the same bytes.
tarred() {
    tar --sort=name --owner=0 --group=0 --numeric-owner --mode=go=rX,u=rwX --mtime="@$commit_time" -C "$2" -cf - "$3" |
        gzip -n9 >"$1"
}

# commit_in FOLDER: puts the commit into FOLDER, with the versions of crates that the build uses.
commit_in() {
    cargo fetch --quiet
    git clone --quiet --shared . "$1"
    cp Cargo.lock "$1"
}

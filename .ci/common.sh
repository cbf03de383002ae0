# Shared by the scripts of this folder; to be read with `source` from the root of the repository.

target=${CARGO_TARGET_DIR:-target}

# step NAME COMMAND...: runs the command and prints how long it took.
step() {
    local name=$1 start=$SECONDS
    shift
    echo "== $name"
    "$@"
    echo "== $name: $((SECONDS - start)) s"
}

# install PACKAGE...: installs packages of Debian.
install() {
    { apt-get update -qq && apt-get install --yes --quiet "$@"; } >&2
}

# Shared by the scripts of this folder; to be read with `source` from the root of the repository.

# These builds are not debugged: without debug information and incremental compilation they take half the time and disk.
export CARGO_PROFILE_DEV_DEBUG=0 CARGO_INCREMENTAL=0

target=${CARGO_TARGET_DIR:-target}

# step NAME COMMAND...: runs the command and prints how long it took.
step() {
    local name=$1 start=$SECONDS
    shift
    echo "== $name"
    "$@"
    echo "== $name: $((SECONDS - start)) s"
}

# What the scripts of this folder share; to be read with `source` from the root of the repository.

# Nobody debugs here: without debug information and incremental compilation builds take half the time and disk.
export CARGO_PROFILE_DEV_DEBUG=0 CARGO_INCREMENTAL=0

target=${CARGO_TARGET_DIR:-target}

# step NAME COMMAND...: runs the command, and says how long it took.
step() {
    local name=$1 start=$SECONDS
    shift
    echo "== $name"
    "$@"
    echo "== $name: $((SECONDS - start)) s"
}

# Shared by the scripts of this folder; to be read with `source` from the root of the repository.

target=${CARGO_TARGET_DIR:-target}

# Sets `spent` to the hundredths of a second that processors have worked for commands of this shell that have ended.
count_spent() {
    local stat
    read -ra stat </proc/$BASHPID/stat
    spent=$((stat[15] + stat[16]))
}

# step NAME COMMAND...: runs the command and prints how long it took, and how long processors worked for it, which a busy machine
# hardly changes.
step() {
    local name=$1 start=$SECONDS spent before
    count_spent
    before=$spent
    shift
    echo "== $name"
    "$@"
    count_spent
    echo "== $name: $((SECONDS - start)) s, $(((spent - before) / 100)) s of processor"
}

# install PACKAGE...: installs packages of Debian, one call after the other.
install() {
    mkdir -p "$target"
    flock "$target/.install" bash -c 'apt-get update -qq && apt-get install --yes --quiet "$@"' install "$@" >&2
}

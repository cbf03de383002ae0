# Shared by the scripts of this folder; to be read with `source` from the root of the repository.

target=${CARGO_TARGET_DIR:-target}

# Hundredths of a second that processors have spent on commands that have ended.
spent() {
    local stat
    read -ra stat </proc/$$/stat
    echo $((stat[15] + stat[16]))
}

# step NAME COMMAND...: runs the command and prints how long it took, and how long processors worked for it, which a busy machine
# hardly changes.
step() {
    local name=$1 start=$SECONDS before
    before=$(spent)
    shift
    echo "== $name"
    "$@"
    echo "== $name: $((SECONDS - start)) s, $((($(spent) - before) / 100)) s of processor"
}

# install PACKAGE...: installs packages of Debian.
install() {
    { apt-get update -qq && apt-get install --yes --quiet "$@"; } >&2
}

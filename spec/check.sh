#!/usr/bin/env bash
# spec/check.sh [FOLDER]: compares the second reader (reader.py, written from the specification alone) with Slicewalk on the
# samples and on archives that it converts. FOLDER has the built programs; without it they are built. Needs Python 3.10 or
# newer and, once, its package index for `zstandard`.
set -euo pipefail
export PYTHONDONTWRITEBYTECODE=1
cd "$(dirname "$0")/.."

python=$(command -v python3 || true)
if [ -z "$python" ] || ! "$python" -c 'import sys, venv; sys.exit(sys.version_info < (3, 10))'; then
    echo "spec/check.sh: skipped, it needs python3 (3.10 or newer, with venv)"
    exit 0
fi
target=${CARGO_TARGET_DIR:-target}
venv=$target/reader-venv
if ! "$venv/bin/python" -c 'import zstandard' 2>/dev/null; then
    "$python" -m venv --clear "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check 'zstandard>=0.22,<1'
fi

fresh=$(mktemp -d)
trap 'rm -rf "$fresh"' EXIT
programs=${1:-}
if [ -z "$programs" ]; then
    programs=$target/debug
    cargo build --quiet --bins --example content -p slicewalk -p scangen
fi

compare() {
    "$venv/bin/python" spec/reader.py "$1" --twin "$2"
}

# scan NAME "OPTIONS OF SLICECONV" OPTIONS OF SCANGEN...: makes a scan, converts it, and compares what both readers find.
scan() {
    local name=$1 options=$2
    shift 2
    "$programs/scangen" "$@" -o "$fresh/$name.las"
    # shellcheck disable=SC2086 # several options
    "$programs/sliceconv" "$fresh/$name.las" -o "$fresh/$name.slices" --quiet $options
    "$programs/examples/content" "$fresh/$name.slices" >"$fresh/$name.json"
    compare "$fresh/$name.slices" "$fresh/$name.json"
}

"$venv/bin/python" spec/excerpts.py
"$venv/bin/python" spec/many_blocks.py
for sample in spec/samples/*.slices; do
    compare "$sample" "${sample%.slices}.json"
done
scan millimetres "--pixel 0.05 --levels on" stairs --density 2000 --noise 0.002
scan centimetres "--pixel 0.05" stairs --density 2000 --noise 0.01 --scale 0.01
scan slope "--pixel 0.29 --classifier thesis" plane --param slope=30 --scale 0.01 --translate -3,-4,-60
scan feet "--pixel 0.1016 --tolerance 0.02" corridor --density 1000 --noise 0.003 --scale 0.01 --origin 150000,400000,40
scan house "--pixel 0.1 --min-points 2 --levels on" house --density 300 --noise 0.005 --rotate 30
scan ground "--pixel 0.1 --tolerance 0.025" house --density 300 --noise 0.003
printf 'file,x,y,z\nseen.las,1.5,3.5,1.6\n' >"$fresh/stations.csv"
scan seen "--pixel 0.1 --levels on --free-space --stations $fresh/stations.csv" \
    house --mode scanner --points 100000 --station 1.5,3.5,1.6

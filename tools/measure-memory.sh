#!/usr/bin/env bash
# Measures guarantee G5: peak resident memory of sliceconv (as the kernel counts it), wall time, and temporary bytes per
# point, on scans that exceed the budget. Fails if a peak exceeds the budget by more than 64 MiB.
#
#   tools/measure-memory.sh [WORK_FOLDER] [PERCENT]
#
# The folder (default: a new one) takes about 12 GB; PERCENT (default 100) shrinks the scans. Needs GNU time. Takes a
# quarter of an hour on two cores, mostly to generate the scans; existing ones are used again.
set -euo pipefail
cd "$(dirname "$0")/.."
work=${1:-$(mktemp -d)}
percent=${2:-100}
cargo build --release --quiet -p sliceconv --bin sliceconv
cargo build --release --quiet -p scangen --bin scangen
bin=$PWD/target/release
mkdir -p "$work/temp"
failed=0

scan() { # NAME POINTS SCANGEN_ARGUMENTS...
    local name=$1 points=$(($2 * percent / 100))
    shift 2
    [ -e "$work/$name" ] || "$bin/scangen" "$@" --points "$points" -o "$work/part-$name" 2>/dev/null
    [ -e "$work/$name" ] || mv "$work/part-$name" "$work/$name"
}

measure() { # TITLE BUDGET_MIB SLICECONV_ARGUMENTS...
    local title=$1 budget=$2 rc=0
    shift 2
    (cd "$work" && command time -f "%M %e" -o time.txt "$bin/sliceconv" "$@" -o out.slices --force --quiet --json \
        --units m --memory "${budget}MiB" --temp-dir temp >out.json 2>err.txt) || rc=$?
    local peak wall
    read -r peak wall < <(tail -n 1 "$work/time.txt")
    local mib=$(((peak + 1023) / 1024)) said=""
    [ "$mib" -le $((budget + 64)) ] || { said="  TOO MUCH"; failed=1; }
    if [ "$rc" = 0 ]; then
        local read_ temp
        read_=$(sed -n 's/^ *"points_read": \([0-9]*\).*/\1/p' "$work/out.json")
        temp=$(sed -n 's/^ *"temp_bytes": \([0-9]*\).*/\1/p' "$work/out.json")
        printf '%-52s %5d MiB of %5d + 64 %8s s %7s bytes/point on disk%s\n' "$title" "$mib" "$budget" "$wall" \
            "$(awk "BEGIN { printf \"%.2f\", $temp / $read_ }")" "$said"
    else
        printf '%-52s %5d MiB of %5d + 64 %8s s  %s%s\n' "$title" "$mib" "$budget" "$wall" "$(tail -n 1 "$work/err.txt")" "$said"
    fi
}

scan uniform.las 100000000 uniform
scan colours.las 100000000 uniform --format 7 --colour 4
scan far-x.las 1000 plane --origin 10000000,0,0
scan far-z.las 1000 plane --origin 0,0,10000000
scan coincident.las 20000000 plane --param size=0.01 --scale 1
scan one-chunk.laz 20000000 uniform --chunk 4294967294
scan wall.las 10000000 plane --param slope=90 --param size=1000 --param heading=0
scan street.las 30000000 street --param length=10000
scan sparse.las 5000000 uniform --param size=100000 --scale 0.01

measure "100 M shuffled points, 2 GB" 256 uniform.las --pixel 0.1
measure "the same and an outlier at x = 1e7 m" 256 uniform.las far-x.las --pixel 0.1
measure "the same and an outlier at z = 1e7 m" 256 uniform.las far-z.las --pixel 0.1
measure "100 M shuffled points at the least budget" 64 uniform.las --pixel 0.1
measure "100 M shuffled points, 16-bit RGB, levels, 3.6 GB" 256 colours.las --pixel 0.1 --colour rgb --levels on
measure "20 M coincident points" 64 coincident.las --pixel 0.05
measure "20 M points in one LAZ chunk" 64 one-chunk.laz --pixel 0.1
measure "10 M points on a wall 1 km high" 64 wall.las --pixel 0.1
measure "30 M points along 10 km of street" 64 street.las --pixel 0.1
measure "5 M points scattered over 100 x 100 km" 64 sparse.las --pixel 0.5
exit $failed

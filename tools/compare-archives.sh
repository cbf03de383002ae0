#!/usr/bin/env bash
# Checks that two builds of sliceconv make the same bytes: runs equal conversions with both and compares the archives.
#
#   tools/compare-archives.sh OLD/sliceconv NEW/sliceconv [SCANGEN]
#
# Uses generated scenes and meshes, and the real scans and meshes in the folder SLICEWALK_DATA if it is set.
# Exits with 1 if an archive differs or a conversion fails in one build only.
set -euo pipefail
old=$(realpath "${1:?old sliceconv}") new=$(realpath "${2:?new sliceconv}")
scangen=$(realpath "${3:-$(dirname "$new")/scangen}")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"

"$scangen" house -o house.laz --points 400000 --noise 0.003 --seed 7
"$scangen" ramps -o ramps.las --points 200000 --seed 3 --shuffle
"$scangen" terrain -o terrain.las --points 150000 --seed 5 --origin 500000,5000000,0
"$scangen" house --obj house.obj

failed=0
# compare NAME ARGUMENT...: runs one conversion with both builds
compare() {
    local name=$1
    shift
    "$old" "$@" --quiet --force -o old.slices 2>old.txt && a=0 || a=$?
    "$new" "$@" --quiet --force -o new.slices 2>new.txt && b=0 || b=$?
    if [ "$a" != "$b" ]; then
        echo "DIFFERS $name: exit codes $a and $b: $(cat old.txt new.txt)"
        failed=1
    elif [ "$a" = 0 ] && ! cmp -s old.slices new.slices; then
        echo "DIFFERS $name: $(cmp old.slices new.slices 2>&1 || true)"
        failed=1
    else
        echo "same    $name (exit code $a)"
    fi
    rm -f old.slices new.slices
}

for rule in plane span thesis; do
    compare "house, $rule" house.laz --pixel 0.05 --classifier $rule
done
compare "house, automatic pixels" house.laz
compare "house, thin slices" house.laz --pixel 0.05 --slice 0.05
compare "house, thick slices" house.laz --pixel 0.05 --slice 0.5
compare "house, coarse heights" house.laz --pixel 0.05 --tolerance 0.0125
compare "house, least points and isolated voxels" house.laz --pixel 0.1 --min-points 2 --drop-isolated
compare "house, spilled by one thread" house.laz --pixel 0.02 --memory 64MiB --threads 1
compare "ramps, shuffled" ramps.las --pixel 0.05 --max-slope 30
compare "terrain far from the origin, in feet" terrain.las --pixel 0.5 --units ft
compare "scans and a mesh" ramps.las house.obj --pixel 0.05
compare "mesh, sampled" house.obj --pixel 0.1 --mesh sampled
if [ -n "${SLICEWALK_DATA:-}" ]; then
    for scan in "$SLICEWALK_DATA"/*.laz; do
        case $(basename "$scan") in
            autzen*) compare "$(basename "$scan")" "$scan" --pixel 0.5 --units ft ;;
            *) compare "$(basename "$scan")" "$scan" ;;
        esac
    done
    for mesh in "$SLICEWALK_DATA"/meshes/*.{obj,ply,stl,glb}; do
        [ -f "$mesh" ] && compare "$(basename "$mesh")" "$mesh"
    done
else
    echo "skipped: real scans (SLICEWALK_DATA is not set)"
fi
exit $failed

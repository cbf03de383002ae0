#!/usr/bin/env bash
# check.sh [FOLDER]: opens exports of slicetool in common readers: laspy, libE57, GDAL, ezdxf, trimesh, OctoMap, SuperSplat's
# viewer and the validator of glTF. Uses the programs in FOLDER if they are built there. Needs CPython 3.11 or newer, node and npm, and once
# their package indexes.
set -euo pipefail
root=$(cd "$(dirname "$0")/../../../.." && pwd)
target=${CARGO_TARGET_DIR:-$root/target}
programs=${1:-}
if [ -z "$programs" ]; then
    (cd "$root" && cargo build --quiet -p slicetool -p scangen -p slicewalk --bins)
    programs=$target/debug
fi
programs=$(cd "$programs" && pwd)
readers=$target/export-readers
if ! "$readers/venv/bin/python" -c 'import ezdxf, laspy, pye57, rasterio, trimesh' 2>/dev/null; then
    python3 -m venv --clear "$readers/venv"
    "$readers/venv/bin/pip" install --quiet --disable-pip-version-check -r "$root/tools/slicetool/tests/readers/requirements.txt"
fi
if [ ! -d "$readers/node_modules/@playcanvas/supersplat-viewer" ]; then
    npm install --silent --no-save --no-audit --no-fund --ignore-scripts --prefix "$readers" gltf-validator@2.0.0-dev.3.10 \
        @playcanvas/supersplat-viewer@1.36.2
fi

if ! command -v bt2vrml >/dev/null; then
    (cd "$root" && source .ci/common.sh && install octomap-tools) || echo "skipped: octomap-tools cannot be installed" >&2
fi

made=$(mktemp -d)
trap 'rm -rf "$made"' EXIT
cd "$made"
"$programs/scangen" demo -o house.laz
"$programs/sliceconv" house.laz -o house.slices --pixel 0.05 --units m --crs EPSG:28992 --quiet
for ending in ply las laz e57 tif svg dxf glb bt voxel.json; do
    "$programs/slicetool" export house.slices -o "house.$ending"
done
"$programs/slicetool" export house.slices -o house_layers.tif --layer height,slope,roughness,headroom,clearance
"$programs/slicetool" export house.slices -o house.npy --esdf --bounds 1,1,0,5,4,2.5
node "$root/tools/slicetool/tests/readers/voxel.cjs" "$readers/node_modules" house
trees=(house.bt house.voxel.json)
if command -v bt2vrml >/dev/null; then
    bt2vrml house.bt >/dev/null
    convert_octree house.bt house.ot >/dev/null
    trees+=(house.ot)
fi
# Cubes of any format are the same cubes again.
for tree in "${trees[@]}"; do
    "$programs/sliceconv" "$tree" -o again.slices --force --quiet
    "$programs/slicetool" export again.slices -o again.bt
    cmp again.bt house.bt
done
echo "cubes of ${trees[*]}: the same bytes again"
PYTHONDONTWRITEBYTECODE=1 "$readers/venv/bin/python" "$root/tools/slicetool/tests/readers/check.py" "$made"
NODE_PATH=$readers/node_modules node -e '
    const { readFileSync } = require("node:fs");
    require("gltf-validator").validateBytes(new Uint8Array(readFileSync("house.glb"))).then(({ issues }) => {
        console.log(`glTF validator: ${issues.numErrors} errors, ${issues.numWarnings} warnings`);
        if (issues.numErrors + issues.numWarnings > 0) throw new Error(JSON.stringify(issues.messages.slice(0, 3)));
    });'

#!/usr/bin/env bash
# Builds the viewer; see `build.mjs`, which does the same on systems without a shell.
set -euo pipefail
if ! command -v node >/dev/null; then
    echo "build.sh: node is not installed; install Node.js 20.19 or newer" >&2
    exit 1
fi
exec node "$(dirname "$0")/build.mjs" "$@"

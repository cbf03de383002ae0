#!/bin/bash -eu
# OUT=FOLDER tests/fuzz/build.sh, from the root: the fuzzer as OSS-Fuzz runs it, a program for each target with its seeds. OSS-Fuzz sets
# the compiler's flags for the sanitizer; those for coverage are of `.ci/instrumented`.
RUSTC_WORKSPACE_WRAPPER=$PWD/.ci/instrumented CARGO_PROFILE_RELEASE_DEBUG_ASSERTIONS=true CARGO_PROFILE_RELEASE_OVERFLOW_CHECKS=true \
    cargo build --release -p slicewalk-fuzz --bin fuzzer
fuzzer=${CARGO_TARGET_DIR:-target}/release/fuzzer
for name in $("$fuzzer"); do
    cp "$fuzzer" "$OUT/$name"
    zip -jqr "$OUT/${name}_seed_corpus.zip" "tests/fuzz/seeds/$name"
done
zip -jq "$OUT/archive_seed_corpus.zip" spec/samples/*.slices

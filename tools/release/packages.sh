# Packages for other languages, and what describes a release; read by `run`.

make_page() {
    local name=slicewalk-$version-page tgz fresh=$work/npm
    tools/viewer/build.sh
    mkdir -p "$work/$name" "$fresh"
    cp -r tools/viewer/dist/. "$work/$name"
    tarred "$out/$name.tar.gz" "$work" "$name"

    (cd tools/viewer/package && npm pack --silent --pack-destination "$work" >/dev/null)
    tgz=$out/slicewalk-npm-$version.tgz
    mv "$work/slicewalk-$version.tgz" "$tgz"
    echo '{"type": "module"}' >"$fresh/package.json"
    cp "$here/try.mjs" spec/samples/*.slices "$fresh"
    (cd "$fresh" && npm install --silent --offline --no-audit --no-fund "$tgz" && node try.mjs)
}

make_licences() {
    local about clone=$work/licences
    about=$(cargo_tool cargo-about 0.9.3 --features cli)
    commit_in "$clone"
    # No release contains the fuzzer, which needs a licence that `about.toml` does not accept; cargo-about leaves out no member.
    sed -i 's|, "tests/fuzz"||' "$clone/Cargo.toml"
    "$about" generate --fail --offline --workspace --all-features --config "$here/about.toml" --manifest-path "$clone/Cargo.toml" \
        --output-file "$out/slicewalk-$version-licences.txt" "$here/licences.hbs"
    grep -q "zstd" "$out/slicewalk-$version-licences.txt" || fail "the licences lack those of zstd"
}

make_python() {
    local bin wheel venv=$work/venv
    bin=$(python_tools "maturin>=1.9.4,<2" ziglang==0.15.2 auditwheel)
    rm -f "$out"/slicewalk-"$version"-*.whl "$out/slicewalk-$version.tar.gz"
    # Linked with the oldest glibc of the tag; maturin checks the symbols.
    PATH=$bin:$PATH "$bin/maturin" build --quiet --zig --compatibility manylinux2014 --manifest-path tools/python/Cargo.toml \
        --target-dir "$target" --out "$out"
    PATH=$bin:$PATH "$bin/maturin" sdist --manifest-path tools/python/Cargo.toml --out "$out" >/dev/null
    wheel=$(from_folder "slicewalk-$version-*manylinux*.whl" python)
    "$bin/auditwheel" show "$wheel" | grep -q manylinux_2_17_x86_64 || fail "$wheel: auditwheel finds symbols newer than manylinux2014"

    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check "$wheel"
    (cd "$work" && "$venv/bin/python" "$here/try.py" "$version")
    # The source package: its metadata is that of the wheel.
    "$venv/bin/pip" install --quiet --disable-pip-version-check --dry-run --no-deps --force-reinstall --report "$work/sdist.json" \
        "$out/slicewalk-$version.tar.gz"
    python3 - "$work/sdist.json" "$version" <<'END'
import json, sys

[found] = json.load(open(sys.argv[1]))["install"]
about = found["metadata"]
assert (about["name"], about["version"]) == ("slicewalk", sys.argv[2]), about
END
}

make_crates() {
    # In the order in which they are published: each depends on those before it.
    local packages=(slicewalk-base slicewalk-cube slicewalk-input slicewalk-mesh slicewalk-splat slicewalk slicewalk-convert
        slicewalk-terminal scangen sliceconv slicetool)
    local package selected=()
    for package in "${packages[@]}"; do
        selected+=(-p "$package")
    done
    cargo package --quiet --no-verify --target-dir "$work/packages" "${selected[@]}"
    for package in "${packages[@]}"; do
        cp "$work/packages/package/$package-$version.crate" "$out"
    done
}

make_sbom() {
    local cyclonedx program clone=$work/sbom
    cyclonedx=$(cargo_tool cargo-cyclonedx 0.5.9)
    # It writes beside the manifests.
    commit_in "$clone"
    for program in sliceconv slicetool; do
        (cd "$clone" && "$cyclonedx" cyclonedx --quiet --manifest-path "tools/$program/Cargo.toml" --format json --spec-version 1.5 \
            --features clouds --target x86_64-unknown-linux-musl --override-filename release)
        mv "$clone/tools/$program/release.json" "$out/$program-$version.cdx.json"
        python3 - "$out/$program-$version.cdx.json" <<'END'
import json, sys

found = {part["name"] for part in json.load(open(sys.argv[1]))["components"]}
missing = {"zstd-sys", "rustls", "clap"} - found
assert not missing, f"{sys.argv[1]} lacks {missing}"
END
    done
}

//! `slicetool serve` and `slicetool site`: the built binary, queried by a plain client over a socket.
#![cfg(feature = "serve")]

use scangen::{WriteSpec, write_las};
use slicewalk::NoMonitor;
use slicewalk_convert::{ConvertOptions, PixelSize, convert};
use std::collections::HashMap;
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Longest wait for a server.
const PATIENCE: Duration = Duration::from_secs(60);

fn archive(path: &Path, height: f64) {
    let folder = tempfile::tempdir().unwrap();
    let scan = folder.path().join("scan.las");
    let step = |n: i32| f64::from(n) * 0.05 + 0.025;
    let points: Vec<_> = (0..60).flat_map(|i| (0..60).map(move |j| [step(i), step(j), height])).collect();
    write_las(&scan, points, &WriteSpec::for_path(&scan)).unwrap();
    let mut options = ConvertOptions::new(vec![scan], path.to_owned());
    options.grid.pixel = PixelSize::Metres(0.1);
    options.overwrite = true;
    convert(&options, &NoMonitor).unwrap();
}

/// Archives `a.slices` and `b.slices`, a page, and a secret beside it.
fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    archive(&at.join("a.slices"), 0.35);
    archive(&at.join("b.slices"), 1.35);
    for (name, text) in [
        ("page/index.html", "<title>page</title>"),
        ("page/archives.json", "{}"),
        ("page/assets/engine.wasm", "\0asm"),
        ("page/assets/main.js", "let a;"),
        ("page/.hidden", "secret"),
        ("secret.txt", "secret"),
    ] {
        let path = at.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }
    folder
}

fn command(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_slicetool"));
    command.current_dir(folder).args(arguments).stdin(Stdio::null());
    command
}

fn run(folder: &Path, arguments: &[&str]) -> Output {
    command(folder, arguments).output().unwrap()
}

/// Checks that the command fails with one line, which is returned.
fn refuses(folder: &Path, arguments: &[&str]) -> String {
    let out = run(folder, arguments);
    let said = String::from_utf8(out.stderr).unwrap();
    assert_eq!((out.status.code(), out.stdout.len()), (Some(1), 0), "{arguments:?}: {said}");
    assert!(said.lines().count() == 1 && said.starts_with("slicetool: "), "{arguments:?}: {said}");
    said
}

struct Server {
    child: Child,
    address: String,
}

impl Server {
    fn start(folder: &Path, arguments: &[&str]) -> Self {
        let all = [&["serve"], arguments, &["--page", "page"]].concat();
        Self::of(&mut command(folder, &all))
    }

    fn of(command: &mut Command) -> Self {
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let address = line.trim_end().strip_prefix("http://").and_then(|rest| rest.strip_suffix('/'));
        let address = address.unwrap_or_else(|| panic!("{line:?}")).to_owned();
        assert!(address.starts_with("127.0.0.1:"), "{line:?}");
        Self { child, address }
    }

    /// Sends `GET path` with additional headers, each ending in `\r\n`.
    fn get(&self, path: &str, headers: &str) -> Answer {
        self.ask(&format!("GET {path} HTTP/1.1\r\nHost: {}\r\n{headers}Connection: close\r\n\r\n", self.address))
    }

    fn ask(&self, request: &str) -> Answer {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).unwrap();
        let end = bytes.windows(4).position(|four| four == b"\r\n\r\n").expect("a head");
        let head = String::from_utf8(bytes[..end].to_vec()).unwrap();
        let mut lines = head.lines();
        let status = lines.next().unwrap().split(' ').nth(1).unwrap().parse().unwrap();
        let headers = lines.map(|line| line.split_once(": ").unwrap());
        let headers = headers.map(|(name, value)| (name.to_ascii_lowercase(), value.to_owned())).collect();
        Answer { status, headers, body: bytes[end + 4..].to_vec() }
    }

    /// Waits for the exit code.
    #[cfg(unix)]
    fn wait(&mut self) -> Option<i32> {
        let end = Instant::now() + PATIENCE;
        while Instant::now() < end {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status.code();
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        panic!("the server does not stop")
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

struct Answer {
    status: u16,
    headers: HashMap<String, String>,
    body: Vec<u8>,
}

impl Answer {
    fn header(&self, name: &str) -> &str {
        self.headers.get(name).map_or("", String::as_str)
    }
}

#[test]
fn archives_are_served_by_ranges() {
    let folder = folder();
    let whole = fs::read(folder.path().join("a.slices")).unwrap();
    let server = Server::start(folder.path(), &["a.slices"]);
    let all = server.get("/a.slices", "");
    assert_eq!((all.status, all.header("accept-ranges")), (200, "bytes"));
    assert_eq!(all.header("content-type"), "application/octet-stream");
    assert!(all.body == whole && all.header("last-modified").ends_with(" GMT"));
    let tag = all.header("etag").to_owned();
    assert!(tag.starts_with('"') && tag.len() > 10, "{tag}");

    let part = server.get("/a.slices", "Range: bytes=10-29\r\n");
    assert_eq!((part.status, part.header("etag")), (206, tag.as_str()));
    assert_eq!(part.header("content-range"), format!("bytes 10-29/{}", whole.len()));
    assert_eq!(part.body, whole[10..30]);
    let end = server.get("/a.slices", "Range: bytes=-7\r\n");
    assert_eq!((end.status, end.body.as_slice()), (206, &whole[whole.len() - 7..]));
    let outside = server.get("/a.slices", "Range: bytes=99999999-\r\n");
    assert_eq!((outside.status, outside.body.len()), (416, 0));
    assert_eq!(outside.header("content-range"), format!("bytes */{}", whole.len()));

    let same = server.get("/a.slices", &format!("Range: bytes=0-3\r\nIf-Range: {tag}\r\n"));
    assert_eq!((same.status, same.body.len()), (206, 4));
    let other = server.get("/a.slices", "Range: bytes=0-3\r\nIf-Range: \"other\"\r\n");
    assert_eq!((other.status, other.body.len()), (200, whole.len()));
    assert_eq!(server.get("/a.slices", &format!("If-None-Match: {tag}\r\n")).status, 304);
    let host = format!("Host: {}\r\nConnection: close\r\n\r\n", server.address);
    let head = server.ask(&format!("HEAD /a.slices HTTP/1.1\r\n{host}"));
    assert_eq!(
        (head.status, head.header("content-length"), head.body.len()),
        (200, whole.len().to_string().as_str(), 0)
    );
    let post = server.ask(&format!("POST /a.slices HTTP/1.1\r\nContent-Length: 0\r\n{host}"));
    assert_eq!((post.status, post.header("allow")), (405, "GET, HEAD"));
}

#[test]
#[cfg(unix)]
fn a_file_is_also_shown_by_its_address() {
    let folder = folder();
    let at = folder.path();
    let whole = fs::read(at.join("a.slices")).unwrap();
    let address = format!("file://{}/a.slices", at.display());
    let server = Server::start(at, &[&address]);
    assert!(server.get("/a.slices", "").body == whole);
    let out = run(at, &site(&address, &[]));
    assert!(out.status.success() && fs::read(at.join("site/a.slices")).unwrap() == whole, "{out:?}");
}

#[test]
fn the_page_comes_with_its_types_and_policy_and_knows_the_archives() {
    let folder = folder();
    fs::create_dir(folder.path().join("other")).unwrap();
    fs::copy(folder.path().join("b.slices"), folder.path().join("other/a.slices")).unwrap();
    fs::rename(folder.path().join("b.slices"), folder.path().join("über b.slices")).unwrap();
    let server = Server::start(folder.path(), &["a.slices", "über b.slices", "other/a.slices"]);
    let index = server.get("/", "");
    assert_eq!((index.status, index.header("content-type")), (200, "text/html; charset=utf-8"));
    assert_eq!(index.body, b"<title>page</title>");
    let policy = index.header("content-security-policy");
    assert!(
        policy.contains("script-src 'self' 'wasm-unsafe-eval';") && policy.contains("default-src 'none'"),
        "{policy}"
    );
    // The address may name archives of other hosts.
    assert!(policy.contains("connect-src 'self' blob: https: http:;"), "{policy}");
    assert_eq!(index.header("x-content-type-options"), "nosniff");
    assert_eq!(server.get("/assets/engine.wasm", "").header("content-type"), "application/wasm");
    assert_eq!(server.get("/assets/main.js?v=1", "").header("content-type"), "text/javascript; charset=utf-8");
    let table: serde_json::Value = serde_json::from_slice(&server.get("/archives.json", "").body).unwrap();
    let urls: Vec<_> = table["archives"].as_array().unwrap().iter().map(|a| a["url"].as_str().unwrap()).collect();
    assert_eq!(urls, ["a.slices", "%C3%BCber%20b.slices", "a-2.slices"]);
    let third = fs::read(folder.path().join("other/a.slices")).unwrap();
    assert_eq!(server.get("/a-2.slices", "").body, third);
    assert_eq!(server.get("/%C3%BCber%20b.slices", "Range: bytes=0-1\r\n").status, 206);
}

#[test]
fn the_page_is_packed_for_browsers_that_take_it_and_archives_never_are() {
    let folder = folder();
    let text = "let a = 1;\n".repeat(1000);
    fs::write(folder.path().join("page/assets/main.js"), &text).unwrap();
    let server = Server::start(folder.path(), &["a.slices"]);
    for takes in ["gzip", "br, GZIP;q=0.5", "deflate,gzip"] {
        let packed = server.get("/assets/main.js", &format!("Accept-Encoding: {takes}\r\n"));
        assert_eq!((packed.status, packed.header("content-encoding")), (200, "gzip"), "{takes}");
        assert!(packed.body.len() < text.len() / 10, "{takes}");
        let mut unpacked = String::new();
        flate2::read::GzDecoder::new(&*packed.body).read_to_string(&mut unpacked).unwrap();
        assert!(unpacked == text, "{takes}");
        let again = format!("Accept-Encoding: gzip\r\nIf-None-Match: {}\r\n", packed.header("etag"));
        assert_eq!(server.get("/assets/main.js", &again).status, 304);
    }
    let plain = server.get("/assets/main.js", "");
    assert_eq!((plain.body.as_slice(), plain.header("vary")), (text.as_bytes(), "accept-encoding"));
    for takes in ["identity", "gzip;q=0", "gzip; q=0.0, br", "x-gzip2"] {
        let answer = server.get("/assets/main.js", &format!("Accept-Encoding: {takes}\r\n"));
        assert!(answer.body == text.as_bytes() && !answer.headers.contains_key("content-encoding"), "{takes}");
        assert_eq!(answer.header("etag"), plain.header("etag"));
    }
    let range = server.get("/assets/main.js", "Accept-Encoding: gzip\r\nRange: bytes=3-9\r\n");
    assert_eq!((range.status, range.body.as_slice()), (206, &text.as_bytes()[3..10]));
    let whole = server.get("/a.slices", "Accept-Encoding: gzip\r\n");
    assert!(whole.body == fs::read(folder.path().join("a.slices")).unwrap());
}

#[test]
fn nothing_else_of_the_disk_is_served() {
    let folder = folder();
    let server = Server::start(folder.path(), &["a.slices"]);
    #[cfg(unix)]
    std::os::unix::fs::symlink("../secret.txt", folder.path().join("page/link.txt")).unwrap();
    let absolute = format!(
        "/{}",
        folder.path().join("secret.txt").display().to_string().replace('\\', "/").trim_start_matches('/')
    );
    let paths = [
        "/secret.txt",
        "/../secret.txt",
        "/assets/../../secret.txt",
        "/%2e%2e/secret.txt",
        "/..%2fsecret.txt",
        "/..%5csecret.txt",
        "//secret.txt",
        "/.hidden",
        "/page/index.html",
        "/link.txt",
        "/b.slices",
        "/a.slices/",
        "/A.slices",
        "/%00",
        "/%ff",
        "/assets/",
        absolute.as_str(),
    ];
    for path in paths {
        let answer = server.get(path, "");
        assert_eq!(answer.status, 404, "{path}");
        assert!(!String::from_utf8_lossy(&answer.body).contains("secret"), "{path}");
    }
    // A foreign name that resolves to this machine must not read scans from the browser.
    let foreign = server.ask("GET /a.slices HTTP/1.1\r\nHost: example.com\r\nConnection: close\r\n\r\n");
    assert_eq!(foreign.status, 403);
    // Nor one in the address, as in HTTP/2, or no name at all.
    let host = format!("Host: {}\r\nConnection: close\r\n\r\n", server.address);
    let address = server.ask(&format!("GET http://example.com/a.slices HTTP/1.1\r\n{host}"));
    assert_eq!(address.status, 403);
    let own = server.ask(&format!("GET http://{}/a.slices HTTP/1.1\r\n{host}", server.address));
    assert_eq!(own.status, 200);
    let second = server.ask(&format!("GET /a.slices HTTP/1.1\r\nHost: localhost\r\nHost: example.com\r\n{host}"));
    assert_eq!(second.status, 403);
    let nameless = server.ask("GET /a.slices HTTP/1.0\r\n\r\n");
    assert_eq!(nameless.status, 403);
}

#[test]
#[ignore = "slow: .ci/run"]
fn connections_that_send_no_whole_request_are_closed() {
    let folder = folder();
    let server = Server::start(folder.path(), &["a.slices"]);
    let sent = ["", "G", "GET / HTTP/1.1\r\n", "GET / HTTP/1.1\r\nHost: localhost\r\nAccept: *"];
    let mut open = sent.map(|text| {
        let mut stream = TcpStream::connect(&server.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(40))).unwrap();
        stream.write_all(text.as_bytes()).unwrap();
        stream
    });
    // Each ends, with an answer or without one.
    for stream in &mut open {
        let mut said = Vec::new();
        stream.read_to_end(&mut said).unwrap();
        assert!(!said.starts_with(b"HTTP/1.1 200"), "{}", String::from_utf8_lossy(&said));
    }
    assert_eq!(server.get("/", "").status, 200);
}

#[cfg(unix)]
#[test]
fn links_in_the_page_are_not_followed() {
    let folder = folder();
    std::os::unix::fs::symlink("../secret.txt", folder.path().join("page/link.txt")).unwrap();
    std::os::unix::fs::symlink("..", folder.path().join("page/up")).unwrap();
    let server = Server::start(folder.path(), &["a.slices"]);
    assert_eq!(server.get("/link.txt", "").status, 404);
    assert_eq!(server.get("/up/secret.txt", "").status, 404);
}

#[test]
fn a_replaced_archive_has_another_tag() {
    let folder = folder();
    let server = Server::start(folder.path(), &["a.slices"]);
    let before = server.get("/a.slices", "Range: bytes=0-9\r\n");
    archive(&folder.path().join("a.slices"), 0.95);
    let after = server.get("/a.slices", &format!("Range: bytes=0-9\r\nIf-Range: {}\r\n", before.header("etag")));
    assert_eq!(after.status, 200);
    assert_ne!(before.header("etag"), after.header("etag"));
    fs::remove_file(folder.path().join("a.slices")).unwrap();
    assert_eq!(server.get("/a.slices", "").status, 404);
}

#[cfg(unix)]
#[test]
fn signals_stop_it_though_a_client_stays_connected() {
    let folder = folder();
    for (signal, code) in [("INT", 130), ("TERM", 143)] {
        let mut server = Server::start(folder.path(), &["a.slices"]);
        let idle = TcpStream::connect(&server.address).unwrap();
        assert_eq!(server.get("/", "").status, 200);
        let killed = Command::new("kill").args(["-s", signal, &server.child.id().to_string()]).status().unwrap();
        assert!(killed.success());
        assert_eq!(server.wait(), Some(code), "{signal}");
        drop(idle);
    }
}

#[test]
fn what_cannot_be_served_is_one_line() {
    let folder = folder();
    let at = folder.path();
    let said = refuses(at, &["serve", "missing.slices", "--page", "page"]);
    assert!(said.contains("missing.slices"), "{said}");
    let said = refuses(at, &["serve", "secret.txt", "--page", "page"]);
    assert!(said.contains("secret.txt"), "{said}");
    let said = refuses(at, &["serve", "a.slices", "--page", "nowhere"]);
    assert!(said.contains("nowhere") && said.contains("tools/viewer/build.mjs"), "{said}");
    let said = refuses(at, &["serve", "a.slices", "--page", "page", "--cloud", "secret.txt"]);
    assert!(said.contains("secret.txt: not a COPC file"), "{said}");
    for command in [&["serve"][..], &["site", "-o", "site"]] {
        let said = refuses(at, &[command, &["https://127.0.0.1:9/far.slices", "--page", "page"]].concat());
        assert!(said.contains("far.slices: expected an archive in a file") && said.contains("fetch it"), "{said}");
    }
    let server = Server::start(at, &["a.slices"]);
    let port = server.address.rsplit_once(':').unwrap().1.to_owned();
    let said = refuses(at, &["serve", "a.slices", "--page", "page", "--port", &port]);
    assert!(said.contains(&format!("--port {port}: cannot listen")), "{said}");
    assert_eq!(run(at, &["serve"]).status.code(), Some(2));
    for option in [["--pixel", "0.1"], ["--units", "ft"], ["--up", "y"]] {
        let out = run(at, &[&["site", "a.slices", "--page", "page", "-o", "site"][..], &option].concat());
        let said = String::from_utf8_lossy(&out.stderr);
        assert!(out.status.code() == Some(2) && said.contains("only for scans"), "{option:?}: {said}");
    }
    assert!(!at.join("site").exists());
}

/// Arguments that write the archive's site, plus `more`.
fn site<'a>(archive: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["site", archive, "-o", "site", "--page", "page"], more].concat()
}

#[test]
fn a_site_is_a_folder_for_any_host() {
    let folder = folder();
    let at = folder.path();
    let out = run(at, &site("a.slices", &[]));
    assert!(out.status.success() && String::from_utf8(out.stdout).unwrap().starts_with("site: "));
    let read = |name: &str| fs::read(at.join("site").join(name)).unwrap_or_else(|_| panic!("{name}"));
    assert_eq!(read("a.slices"), fs::read(at.join("a.slices")).unwrap());
    assert_eq!((read("index.html"), read("assets/engine.wasm")), (b"<title>page</title>".into(), b"\0asm".into()));
    let table: serde_json::Value = serde_json::from_slice(&read("archives.json")).unwrap();
    assert_eq!(table, serde_json::json!({ "archives": [{ "name": "a.slices", "url": "a.slices" }], "cloud": null }));
    assert!(!at.join("site/.hidden").exists());

    // Again: the page is written again, the identical archive may stay.
    fs::write(at.join("page/index.html"), "newer").unwrap();
    assert!(run(at, &site("a.slices", &[])).status.success());
    assert_eq!(read("index.html"), b"newer");
    // A different archive of that name is kept unless forced.
    fs::create_dir(at.join("new")).unwrap();
    fs::rename(at.join("b.slices"), at.join("new/a.slices")).unwrap();
    let said = refuses(at, &site("new/a.slices", &[]));
    assert!(said.contains("--force"), "{said}");
    assert_eq!(read("a.slices"), fs::read(at.join("a.slices")).unwrap());
    assert!(run(at, &site("new/a.slices", &["--force"])).status.success());
    assert_eq!(read("a.slices"), fs::read(at.join("new/a.slices")).unwrap());
    // A file that the command reads is never replaced.
    let said = refuses(at, &["site", "a.slices", "-o", ".", "--page", "page", "--force"]);
    assert!(said.contains("a.slices"), "{said}");
    let left: Vec<_> = fs::read_dir(at.join("site")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert!(left.iter().all(|name| !name.to_string_lossy().contains(".part")), "{left:?}");
}

#[test]
fn a_folder_without_scans_stands_for_the_archives_in_it() {
    let folder = folder();
    let at = folder.path();
    fs::create_dir(at.join("all")).unwrap();
    for name in ["b.slices", "a.slices"] {
        fs::rename(at.join(name), at.join("all").join(name)).unwrap();
    }
    fs::write(at.join("all/settings.json"), r#"{"title": "All"}"#).unwrap();
    fs::write(at.join("all/notes.txt"), "no scan").unwrap();
    let out = run(at, &site("all", &[]));
    assert!(out.status.success(), "{out:?}");
    let table: serde_json::Value = serde_json::from_slice(&fs::read(at.join("site/archives.json")).unwrap()).unwrap();
    let archive = |name: &str| serde_json::json!({ "name": name, "url": name });
    assert_eq!(table["archives"], serde_json::json!([archive("a.slices"), archive("b.slices")]));
    assert_eq!(table["settings"], "settings.json");
    let said = refuses(at, &["site", "all", "-o", "all", "--page", "page", "--force"]);
    assert!(said.contains("a.slices"), "{said}");
    // Scans come first, as for `sliceconv`.
    fs::write(at.join("all/scan.las"), "no scan").unwrap();
    let said = refuses(at, &site("all", &[]));
    assert!(said.contains("scan.las"), "{said}");
}

#[test]
fn a_start_page_of_another_site_stays() {
    let folder = folder();
    let at = folder.path();
    fs::create_dir(at.join("site")).unwrap();
    fs::write(at.join("site/index.html"), "mine").unwrap();
    let said = refuses(at, &site("a.slices", &[]));
    assert!(said.contains("index.html") && said.contains("--force"), "{said}");
    assert!(fs::read(at.join("site/index.html")).unwrap() == b"mine" && !at.join("site/a.slices").exists());
    assert!(run(at, &site("a.slices", &["--force"])).status.success());
    assert_ne!(fs::read(at.join("site/index.html")).unwrap(), b"mine");
}

#[test]
fn an_archive_named_like_a_folder_of_the_page_gets_another_name() {
    let folder = folder();
    let at = folder.path();
    fs::copy(at.join("a.slices"), at.join("assets")).unwrap();
    let out = run(at, &site("assets", &["b.slices"]));
    assert!(out.status.success(), "{out:?}");
    let table: serde_json::Value = serde_json::from_slice(&fs::read(at.join("site/archives.json")).unwrap()).unwrap();
    assert_eq!(table["archives"][0]["url"], "assets-2.slices");
    assert!(fs::read(at.join("site/assets-2.slices")).unwrap() == fs::read(at.join("a.slices")).unwrap());
    assert!(at.join("site/assets/main.js").is_file());
}

#[test]
fn names_that_differ_only_in_case_are_one_to_some_hosts_and_get_numbers() {
    let folder = folder();
    let at = folder.path();
    let more = ["new/A.SLICES", "new/Assets", "new/Settings.json", "new/Ä.slices", "other/ä.slices"];
    for folder in ["new", "other"] {
        fs::create_dir(at.join(folder)).unwrap();
    }
    for name in more {
        fs::copy(at.join("a.slices"), at.join(name)).unwrap();
    }
    let out = run(at, &site("a.slices", &more));
    assert!(out.status.success(), "{out:?}");
    let table: serde_json::Value = serde_json::from_slice(&fs::read(at.join("site/archives.json")).unwrap()).unwrap();
    let names: Vec<_> = table["archives"].as_array().unwrap().iter().map(|entry| entry["name"].clone()).collect();
    let expected = ["a.slices", "A-2.SLICES", "Assets-2.slices", "Settings-2.json", "Ä.slices", "ä-2.slices"];
    assert_eq!(names, expected);
    assert!(expected.iter().all(|name| at.join("site").join(name).is_file()));
}

/// A scan of two levels, and one in text.
fn scans(at: &Path) {
    let step = |n: i32| f64::from(n) * 0.05 + 0.025;
    let points: Vec<_> = (0..60).flat_map(|i| (0..60).map(move |j| [step(i), step(j), f64::from(i / 30)])).collect();
    write_las(&at.join("room.las"), points.clone(), &WriteSpec::for_path(&at.join("room.las"))).unwrap();
    let lines = points.iter().map(|[x, y, z]| format!("{x:.3} {y:.3} {z:.3}\n"));
    fs::write(at.join("lines.xyz"), lines.collect::<String>()).unwrap();
}

/// The archive that `sliceconv` makes for the page of these inputs.
fn converted(at: &Path, inputs: &[&str]) -> Vec<u8> {
    let output = at.join("expected.slices");
    let mut options = ConvertOptions::new(inputs.iter().map(|name| at.join(name)).collect(), output.clone());
    options.sections.colour = slicewalk_convert::ColourMode::Auto;
    options.reading.units = slicewalk_input::Units::Factor(1.0);
    options.grid.pixel = PixelSize::Metres(0.1);
    options.sections.levels = true;
    options.overwrite = true;
    convert(&options, &NoMonitor).unwrap();
    fs::read(output).unwrap()
}

/// Waits until the conversion ends, and returns its error.
fn conversion_of(server: &Server) -> Option<String> {
    let end = Instant::now() + PATIENCE;
    while Instant::now() < end {
        let state: serde_json::Value = serde_json::from_slice(&server.get("/conversion.json", "").body).unwrap();
        if state["converting"].is_null() {
            return state["error"].as_str().map(str::to_owned);
        }
        assert!(state["converting"]["stage"].is_string(), "{state}");
        assert!((0.0..=1.0).contains(&state["converting"]["share"].as_f64().unwrap()), "{state}");
        std::thread::sleep(Duration::from_millis(10));
    }
    panic!("the conversion does not end")
}

const METRES: [&str; 4] = ["--units", "m", "--pixel", "0.1"];

#[test]
fn scans_are_converted_while_the_page_is_served() {
    let folder = folder();
    let at = folder.path();
    scans(at);
    let server = Server::start(at, &[&["a.slices", "room.las", "lines.xyz"], &METRES[..]].concat());
    let table: serde_json::Value = serde_json::from_slice(&server.get("/archives.json", "").body).unwrap();
    let expected = serde_json::json!([
        { "name": "a.slices", "url": "a.slices" },
        { "name": "room.slices", "url": "room.slices", "converting": "conversion.json" },
    ]);
    assert_eq!(table["archives"], expected);
    assert_eq!(conversion_of(&server), None);
    let answer = server.get("/room.slices", "");
    assert_eq!(answer.status, 200);
    assert!(answer.body == converted(at, &["room.las", "lines.xyz"]));
    assert_eq!(server.get("/room.slices", "Range: bytes=0-7\r\n").status, 206);
    assert_eq!(server.get("/room.las", "").status, 404);
}

/// Temporary folders of servers in `temporary`.
#[cfg(unix)]
fn left(temporary: &Path) -> usize {
    fs::read_dir(temporary).unwrap().count()
}

#[cfg(unix)]
#[test]
fn the_converted_archive_goes_with_the_server() {
    let folder = folder();
    let at = folder.path();
    scans(at);
    let temporary = at.join("temporary");
    fs::create_dir(&temporary).unwrap();
    for (signal, code, wait) in [("INT", 130, true), ("TERM", 143, false)] {
        let all = [&["serve", "room.las", "--page", "page"], &METRES[..]].concat();
        let mut command = command(at, &all);
        let mut server = Server::of(command.env("TMPDIR", &temporary));
        if wait {
            assert_eq!(conversion_of(&server), None);
            assert_eq!(left(&temporary), 1);
        }
        let killed = Command::new("kill").args(["-s", signal, &server.child.id().to_string()]).status().unwrap();
        assert!(killed.success());
        assert_eq!((server.wait(), left(&temporary)), (Some(code), 0), "{signal}");
    }
}

#[cfg(unix)]
#[test]
fn signals_while_scans_are_opened_leave_no_folder() {
    let folder = folder();
    let at = folder.path();
    let (temporary, tiles) = (at.join("temporary"), at.join("tiles"));
    fs::create_dir(&temporary).unwrap();
    fs::create_dir(&tiles).unwrap();
    // So many that they are still being opened when the signal comes.
    (0..3000).for_each(|n| fs::write(tiles.join(format!("{n}.xyz")), "1 2 3\n4 5 6\n").unwrap());
    for (signal, code) in [("INT", 130), ("TERM", 143)] {
        let mut command = command(at, &[&["serve", "tiles", "--page", "page"], &METRES[..]].concat());
        let child = command.env("TMPDIR", &temporary).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        while left(&temporary) == 0 {
            std::thread::yield_now();
        }
        let killed = Command::new("kill").args(["-s", signal, &child.id().to_string()]).status().unwrap();
        assert!(killed.success());
        let out = child.wait_with_output().unwrap();
        let said = String::from_utf8(out.stderr).unwrap();
        assert_eq!((out.status.code(), left(&temporary), said.as_str()), (Some(code), 0, ""), "{signal}");
    }
}

#[test]
fn scans_that_cannot_be_converted_end_the_server_with_one_line() {
    let folder = folder();
    let at = folder.path();
    scans(at);
    let whole = fs::read(at.join("room.las")).unwrap();
    fs::write(at.join("cut.las"), &whole[..whole.len() / 2]).unwrap();
    fs::write(at.join("wrong.laz"), "no scan").unwrap();
    for name in ["cut.las", "wrong.laz", "none.laz", "page/index.html"] {
        let said = refuses(at, &[&["serve", name, "--page", "page"], &METRES[..]].concat());
        assert!(said.contains(name), "{said}");
        let said = refuses(at, &[&["site", name, "-o", "site", "--page", "page"], &METRES[..]].concat());
        assert!(said.contains(name), "{said}");
    }
    let out = run(at, &["serve", "room.las", "--page", "page", "--pixel", "0"]);
    assert_eq!(out.status.code(), Some(2));
}

#[test]
fn a_site_of_scans_is_one_of_the_archive() {
    let folder = folder();
    let at = folder.path();
    scans(at);
    let arguments = [&["site", "room.las", "a.slices", "-o", "site", "--page", "page"], &METRES[..]].concat();
    let out = run(at, &arguments);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    assert!(fs::read(at.join("site/room.slices")).unwrap() == converted(at, &["room.las"]));
    let table: serde_json::Value = serde_json::from_slice(&fs::read(at.join("site/archives.json")).unwrap()).unwrap();
    let names: Vec<_> =
        table["archives"].as_array().unwrap().iter().map(|entry| entry["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["room.slices", "a.slices"]);
    assert!(table["archives"][0].get("converting").is_none());
    // The same again changes nothing.
    assert!(run(at, &arguments).status.success());
}

#[test]
fn a_kiosk_and_its_tour_are_in_the_table() {
    let folder = folder();
    let at = folder.path();
    // Editors on Windows begin a text with a byte order mark.
    fs::write(at.join("route.csv"), "\u{feff}# a note\nx,y,z,s\n0.5,0.5,0.4,0\n1.5,0.5,0.4,1\n").unwrap();
    fs::write(at.join("settings.json"), "\u{feff}{\"title\": {\"en\": \"House\", \"de\": \"Haus\"}}").unwrap();
    let server = Server::start(at, &["a.slices", "--kiosk", "60", "--tour", "route.csv"]);
    let table: serde_json::Value = serde_json::from_slice(&server.get("/archives.json", "").body).unwrap();
    assert_eq!((&table["kiosk"], &table["tour"]), (&serde_json::json!(60), &serde_json::json!("route.csv")));
    assert_eq!(table["settings"], "settings.json");
    assert_eq!(server.get("/route.csv", "").body, fs::read(at.join("route.csv")).unwrap());
    assert_eq!(server.get("/settings.json", "").body, fs::read(at.join("settings.json")).unwrap());
    drop(server);

    assert!(run(at, &site("a.slices", &["--kiosk", "60", "--tour", "route.csv"])).status.success());
    assert!(at.join("site/route.csv").is_file() && at.join("site/settings.json").is_file());
    for (text, expected) in [
        ("x,y\n1,2\n3,4\n", "columns x, y and z"),
        ("x,y,z\n1,2,3\n", "at least two places"),
        ("x,y,z\n1,2,3\n1,2,high\n", "line 3"),
    ] {
        fs::write(at.join("bad.csv"), text).unwrap();
        let said = refuses(at, &["serve", "a.slices", "--page", "page", "--tour", "bad.csv"]);
        assert!(said.contains("bad.csv") && said.contains(expected), "{said}");
    }
    // A file of another program is not published.
    fs::write(at.join("settings.json"), r#"{"password": "secret"}"#).unwrap();
    let out = run(at, &["site", "a.slices", "-o", "other", "--page", "page"]);
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(out.status.success() && said.contains("settings.json: left out"), "{said}");
    assert!(!at.join("other/settings.json").exists());
    fs::write(at.join("settings.json"), "[1]").unwrap();
    let said = refuses(at, &["serve", "a.slices", "--page", "page"]);
    assert!(said.contains("settings.json") && said.contains("object"), "{said}");
    assert_eq!(run(at, &["serve", "a.slices", "--page", "page", "--kiosk", "0"]).status.code(), Some(2));
}

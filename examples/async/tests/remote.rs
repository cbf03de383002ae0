//! Archives on a web server: few requests, and an error for everything that a server can do wrong.

#[path = "../../../tests/common/random.rs"]
mod random;

#[path = "../../../tests/stream/tower.rs"]
mod tower;

use slicewalk::NoMonitor;
use slicewalk::archive::{Archive, PageEntry};
use slicewalk::bytes::{ByteSource, RemoteOptions, RemoteSource, interruptible};
use slicewalk::query::{Overlap, overlaps};
use slicewalk::store::{PageSlot, Prefetch, Snapshot, Step, Stream, StreamOptions};
use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tower::{Body, resident, tower};

/// Behaviour of the server.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Manner {
    Good,
    /// Returns everything with status 200.
    Whole,
    /// Stops in the middle of the body and closes.
    Short,
    /// Stops in the middle of the first body, then behaves.
    ShortOnce,
    /// States another version of the object, and ignores conditions.
    OtherTag,
    NotFound,
    Closes,
    Fails,
    /// Returns other bytes than those requested.
    OtherRange,
    /// Answers with this status line and these header lines, and with a body that contains terminal controls.
    Refuses(&'static str, &'static str),
    /// Refuses once, then behaves.
    RefusesOnce(&'static str, &'static str),
    /// Refuses with a body of 64 MiB.
    RefusesAtLength,
    /// Stops in the middle of the first body, then no longer has that version.
    ShortThenReplaced,
    /// Answers with these header lines, too.
    Tells(&'static str),
    /// Sends the body in chunks, without a length, and with this many bytes more than it states.
    Chunked(isize),
    /// Accepts the request and never answers.
    Silent,
    /// Never answers the first request, then behaves.
    SilentOnce,
    /// Sends a hundredth of the body at a time, with this many milliseconds after each.
    Slow(u64),
}

/// A body that must never reach a terminal raw.
const RUDE: &str = "<Error>\n\t<Code>\u{1b}[31mNo\u{7}</Code>\r\n</Error>";

struct State {
    bytes: Vec<u8>,
    tag: Option<String>,
    manner: Manner,
    /// Header lines of all requests.
    requests: Vec<Vec<String>>,
    /// Time of each request.
    times: Vec<Instant>,
    /// Bytes written as bodies of refusals.
    refused: usize,
}

impl State {
    fn new(bytes: Vec<u8>, tag: Option<&str>) -> Self {
        let tag = tag.map(str::to_string);
        Self { bytes, tag, manner: Manner::Good, requests: Vec::new(), times: Vec::new(), refused: 0 }
    }
}

struct Server {
    url: String,
    state: Arc<Mutex<State>>,
    stop: Arc<AtomicBool>,
}

impl Server {
    fn new(bytes: Vec<u8>, tag: Option<&str>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}/scans/tower.slices", listener.local_addr().unwrap());
        let state = Arc::new(Mutex::new(State::new(bytes, tag)));
        let stop = Arc::new(AtomicBool::new(false));
        let (shared, stopped) = (state.clone(), stop.clone());
        std::thread::spawn(move || {
            for client in listener.incoming() {
                if stopped.load(Ordering::Relaxed) {
                    return;
                }
                let _ = answer(client.unwrap(), &shared);
            }
        });
        Self { url, state, stop }
    }

    fn set(&self, manner: Manner) {
        self.state.lock().unwrap().manner = manner;
    }

    fn count(&self) -> usize {
        self.state.lock().unwrap().requests.len()
    }

    fn source(&self) -> slicewalk::Result<RemoteSource> {
        RemoteSource::with(&self.url, &options())
    }

    /// The request line of the last request.
    fn asked(&self) -> String {
        self.state.lock().unwrap().requests.last().unwrap()[0].clone()
    }

    /// Returns whether the last request had this header line.
    fn was_told(&self, line: &str) -> bool {
        self.state.lock().unwrap().requests.last().unwrap().iter().any(|said| said.eq_ignore_ascii_case(line))
    }

    fn archive(&self) -> Archive {
        Archive::from_source(Box::new(self.source().unwrap())).unwrap()
    }
}

fn options() -> RemoteOptions {
    RemoteOptions {
        timeout: Duration::from_secs(5),
        patience: Duration::from_secs(5),
        retries: 1,
        ..RemoteOptions::default()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let _ = TcpStream::connect(self.url.split('/').nth(2).unwrap());
    }
}

/// One request per connection.
fn answer(mut client: TcpStream, state: &Mutex<State>) -> std::io::Result<()> {
    let lines = BufReader::new(client.try_clone()?).lines().map_while(Result::ok);
    let head: Vec<String> = lines.take_while(|line| !line.is_empty()).collect();
    if head.is_empty() {
        return Ok(());
    }
    let field = |name: &str| head.iter().find_map(|line| line.to_lowercase().strip_prefix(name).map(str::to_string));
    let mut state = state.lock().unwrap();
    state.requests.push(head.clone());
    state.times.push(Instant::now());
    let manner = state.manner;
    match manner {
        Manner::ShortOnce | Manner::RefusesOnce(..) | Manner::SilentOnce => state.manner = Manner::Good,
        Manner::ShortThenReplaced => state.manner = Manner::Refuses("412 Precondition Failed", ""),
        _ => {}
    }
    if matches!(manner, Manner::Silent | Manner::SilentOnce) {
        // Until the client gives up.
        std::thread::spawn(move || std::io::Read::read(&mut client, &mut [0]));
        return Ok(());
    }
    let len = state.bytes.len();
    let range = field("range: bytes=").unwrap_or_default();
    let (first, last) = range.split_once('-').unwrap_or(("0", ""));
    let (first, last) = (first.parse::<usize>().unwrap_or(0), last.parse::<usize>().unwrap_or(len).min(len - 1));
    let tag = match manner {
        Manner::OtherTag => Some("\"other\"".to_string()),
        _ => state.tag.clone(),
    };
    let tag_line = tag.as_ref().map_or(String::new(), |tag| format!("ETag: {tag}\r\n"));
    let matches = field("if-match: ").is_none_or(|wanted| Some(wanted) == tag.as_ref().map(|tag| tag.to_lowercase()));
    let status = match manner {
        Manner::Closes => return Ok(()),
        Manner::NotFound => Some("404 Not Found"),
        Manner::Fails => Some("503 Service Unavailable"),
        Manner::OtherTag => None,
        _ if !matches => Some("412 Precondition Failed"),
        _ => None,
    };
    if let Some(status) = status {
        return write!(client, "HTTP/1.1 {status}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n");
    }
    if let Manner::Refuses(status, headers) | Manner::RefusesOnce(status, headers) = manner {
        let length = RUDE.len();
        return write!(
            client,
            "HTTP/1.1 {status}\r\n{headers}Content-Length: {length}\r\nConnection: close\r\n\r\n{RUDE}"
        );
    }
    if manner == Manner::RefusesAtLength {
        write!(client, "HTTP/1.1 403 Forbidden\r\nContent-Length: {}\r\nConnection: close\r\n\r\n", 64 << 20)?;
        for _ in 0..64 {
            client.write_all(&[b'<'; 1 << 20])?;
            state.refused += 1 << 20;
        }
        return Ok(());
    }
    let (code, body, range) = match manner {
        Manner::Whole => ("200 OK", &state.bytes[..], String::new()),
        _ => {
            let shift = usize::from(manner == Manner::OtherRange);
            let range = format!("Content-Range: bytes {}-{last}/{len}\r\n", first + shift);
            ("206 Partial Content", &state.bytes[first + shift..=last], range)
        }
    };
    let length = body.len();
    let range = if let Manner::Tells(lines) = manner { range + lines } else { range };
    if let Manner::Chunked(more) = manner {
        let mut body = body.to_vec();
        body.resize(length.saturating_add_signed(more), b'<');
        write!(client, "HTTP/1.1 {code}\r\n{tag_line}{range}Transfer-Encoding: chunked\r\nConnection: close\r\n\r\n")?;
        for chunk in body.chunks(1000) {
            write!(client, "{:x}\r\n", chunk.len())?;
            client.write_all(chunk)?;
            write!(client, "\r\n")?;
        }
        return write!(client, "0\r\n\r\n");
    }
    write!(client, "HTTP/1.1 {code}\r\n{tag_line}{range}Content-Length: {length}\r\nConnection: close\r\n\r\n")?;
    if let Manner::Slow(wait) = manner {
        for piece in body.chunks(length.div_ceil(100)) {
            client.write_all(piece)?;
            std::thread::sleep(Duration::from_millis(wait));
        }
        return Ok(());
    }
    let short = matches!(manner, Manner::Short | Manner::ShortOnce | Manner::ShortThenReplaced);
    client.write_all(if short { &body[..length / 2] } else { body })
}

/// Returns the error; unlike `expect_err` it does not print a whole page on failure.
fn error_of<T>(result: slicewalk::Result<T>) -> slicewalk::Error {
    result.err().unwrap_or_else(|| panic!("an error was expected"))
}

/// A page beyond the bytes that came with the first request.
fn last_stored(archive: &Archive) -> PageEntry {
    let stored = |entry: &PageEntry| entry.extent().is_some_and(|extent| extent.offset > 16384);
    archive.entries().map(Result::unwrap).filter(stored).last().unwrap()
}

#[test]
fn an_archive_opens_with_two_requests_and_streams_with_few() {
    let bytes = tower(3.0, 60.0, 5);
    let server = Server::new(bytes.clone(), Some("\"one\""));
    let archive = server.archive();
    assert_eq!(server.count(), 2, "head and footer");
    assert_eq!(archive.source().len(), bytes.len() as u64);
    let options = StreamOptions { prefetch: Prefetch::Manual, ..StreamOptions::new(16 << 20) };
    let stream = Stream::open(archive, options).unwrap();
    assert_eq!(server.count(), 3, "the whole directory");
    let mut pawn = stream.pawn();
    let body = Body::at(0.0, 0.0, 40.0);
    pawn.hint(&body.motion());
    while let Step::Loaded(_) = stream.step() {}
    assert!(stream.take_errors().is_empty());
    let counters = stream.counters();
    assert_eq!(server.count() as u64, 3 + counters.reads);
    println!("{} pages in {} requests", counters.loaded, counters.reads);
    assert!(counters.reads * 2 < counters.loaded);
    assert_eq!(overlaps(&stream.snapshot(), &body.shape()), overlaps(&resident(&bytes), &body.shape()));
    let requests = &server.state.lock().unwrap().requests;
    let asks = |request: &Vec<String>| request.iter().any(|line| line.eq_ignore_ascii_case("if-match: \"one\""));
    assert!(!asks(&requests[0]) && requests[1..].iter().all(asks), "all but the first ask for the version");
}

#[test]
fn all_pages_come_in_a_few_requests_and_are_those_of_the_file() {
    let bytes = tower(3.0, 60.0, 5);
    let server = Server::new(bytes.clone(), Some("\"one\""));
    let archive = server.archive();
    let store = Snapshot::resident(&archive, &NoMonitor).unwrap();
    let here = resident(&bytes);
    println!("{} pages of {} bytes in {} requests", store.page_count(), bytes.len(), server.count());
    assert!(store.page_count() > 300);
    // Head, footer, directory, and 1 MiB of pages per request.
    assert!(server.count() <= 4 + bytes.len().div_ceil(1 << 20), "{} requests", server.count());
    assert_eq!((store.page_count(), store.weight_bytes()), (here.page_count(), here.weight_bytes()));
    for number in 0..here.column_count() {
        let ((tx, ty, there), (.., slots)) = (here.column_at(number), store.column_at(number));
        let pages = |slots: &[PageSlot]| slots.iter().map(|slot| slot.page().cloned()).collect::<Vec<_>>();
        assert!(pages(there) == pages(slots), "column {tx}, {ty}");
    }
    // The first page that fails, whichever thread reads it.
    server.set(Manner::OtherTag);
    assert!(error_of(Snapshot::resident(&archive, &NoMonitor)).to_string().contains("replaced"));
}

fn waiting(timeout_s: f64, patience_s: f64) -> RemoteOptions {
    let [timeout, patience] = [timeout_s, patience_s].map(Duration::from_secs_f64);
    RemoteOptions { timeout, patience, ..RemoteOptions::default() }
}

#[test]
fn a_server_that_never_answers_is_left_after_the_time_and_one_that_is_slow_is_not() {
    let bytes = tower(2.0, 30.0, 4);
    let server = Server::new(bytes.clone(), Some("\"one\""));
    let source = RemoteSource::with(&server.url, &waiting(0.5, 0.5)).unwrap();
    let took = |manner: Manner, work: &dyn Fn() -> String| {
        server.set(manner);
        let (asked, start) = (server.count(), Instant::now());
        (work(), start.elapsed().as_secs_f64(), server.count() - asked)
    };
    let open = || error_of(RemoteSource::with(&server.url, &waiting(0.5, 0.5))).to_string();
    let read = || error_of(source.read_at(20_000, &mut [0; 1000])).to_string();
    for work in [&open as &dyn Fn() -> String, &read] {
        let (text, seconds, requests) = took(Manner::Silent, work);
        assert!(text.contains("no answer within 0.5 s"), "{text}");
        assert!((0.5..2.0).contains(&seconds) && requests == 1, "{seconds} s, {requests} requests");
    }
    // A read waits no longer than its patience, however long a request may take.
    let text = error_of(RemoteSource::with(&server.url, &waiting(60.0, 0.3))).to_string();
    assert!(text.contains("no answer within 0.3 s"), "{text}");
    // With more retries, an unanswered request is repeated.
    server.set(Manner::SilentOnce);
    let source = RemoteSource::with(&server.url, &waiting(0.3, 10.0)).unwrap();
    // Three times as long as the time-out, but never silent for that long.
    server.set(Manner::Slow(9));
    let mut all = vec![0; bytes.len()];
    let start = Instant::now();
    source.read_at(0, &mut all).unwrap();
    assert!(start.elapsed() > Duration::from_millis(800) && all == bytes);
}

#[test]
fn a_thread_that_waits_for_a_server_can_be_stopped() {
    let server = Server::new(tower(2.0, 30.0, 4), Some("\"one\""));
    let source = RemoteSource::with(&server.url, &waiting(60.0, 60.0)).unwrap();
    for manner in [Manner::Silent, Manner::Refuses("503 Service Unavailable", "Retry-After: 50\r\n")] {
        server.set(manner);
        let start = Instant::now();
        let stop = move || start.elapsed() > Duration::from_millis(300);
        let read = interruptible(Some(Arc::new(stop)), || source.read_at(20_000, &mut [0; 1000]));
        assert!(matches!(read, Err(slicewalk::Error::Interrupted)), "{manner:?}: {read:?}");
        assert!(start.elapsed() < Duration::from_secs(5), "{manner:?}");
    }
    // A stream ends its own thread in this way.
    server.set(Manner::Good);
    let archive =
        Archive::from_source(Box::new(RemoteSource::with(&server.url, &waiting(60.0, 60.0)).unwrap())).unwrap();
    let stream = Stream::open(archive, StreamOptions::new(16 << 20)).unwrap();
    server.set(Manner::Silent);
    let (asked, mut pawn) = (server.count(), stream.pawn());
    pawn.hint(&Body::at(1.0, 0.0, 25.0).motion());
    while server.count() == asked {
        std::thread::sleep(Duration::from_millis(5));
    }
    let start = Instant::now();
    drop(stream);
    assert!(start.elapsed() < Duration::from_secs(5));
}

#[test]
fn an_object_that_is_replaced_is_an_error_even_if_the_server_does_not_mind() {
    let (old, new) = (tower(2.0, 30.0, 1), tower(2.0, 30.0, 2));
    for tag in [Some("\"one\""), Some("W/\"one\""), None] {
        let server = Server::new(old.clone(), tag);
        let archive = server.archive();
        let entry = last_stored(&archive);
        let good = archive.page(&entry).unwrap();
        server.set(Manner::OtherTag);
        let error = error_of(archive.page(&entry)).to_string();
        assert!(error.contains("replaced"), "{error}");
        server.set(Manner::Good);
        {
            let mut state = server.state.lock().unwrap();
            state.bytes = new.clone();
            state.tag = tag.map(|tag| tag.replace("one", "two"));
        }
        // Without a tag, the length or the checksum in the directory reveals it.
        let error = error_of(archive.page(&entry)).to_string();
        assert!(["replaced", "rule P"].iter().any(|text| error.contains(text)), "{error}");
        *server.state.lock().unwrap() = State::new(old.clone(), tag);
        assert!(archive.page(&entry).unwrap() == good);
    }
}

#[test]
fn whatever_a_server_does_wrong_is_an_error_and_passes_when_it_is_good_again() {
    let server = Server::new(tower(2.0, 30.0, 3), Some("\"one\""));
    let archive = server.archive();
    let entry = last_stored(&archive);
    let good = archive.page(&entry).unwrap();
    for manner in [Manner::Whole, Manner::Short, Manner::NotFound, Manner::Closes, Manner::Fails, Manner::OtherRange] {
        server.set(manner);
        let error = error_of(archive.page(&entry));
        assert!(matches!(error, slicewalk::Error::Io { .. }), "{manner:?}: {error}");
        println!("{manner:?}: {error}");
        let error = server.source().err();
        assert!(error.is_some(), "{manner:?}: opening");
        server.set(Manner::Good);
        assert!(archive.page(&entry).unwrap() == good, "{manner:?}");
    }
    server.set(Manner::ShortOnce);
    assert!(archive.page(&entry).unwrap() == good, "a lost connection is taken up again");
}

#[test]
fn a_stream_reports_a_server_that_went_away_and_its_answers_stay() {
    let server = Server::new(tower(2.0, 60.0, 4), Some("\"one\""));
    let options = StreamOptions { prefetch: Prefetch::Manual, ..StreamOptions::new(16 << 20) };
    let stream = Stream::open(server.archive(), options).unwrap();
    let (here, there) = (Body::at(1.0, 0.0, 3.0), Body::at(1.0, 0.0, 50.0));
    stream.load_around(&here.motion()).unwrap();
    server.set(Manner::Closes);
    let mut pawn = stream.pawn();
    pawn.hint(&there.motion());
    while let Step::Loaded(_) = stream.step() {}
    assert!(!stream.take_errors().is_empty());
    let view = stream.snapshot();
    assert_eq!(overlaps(&view, &here.shape()), Overlap::Hit);
    assert!(matches!(overlaps(&view, &there.shape()), Overlap::NotLoaded(_)));
}

#[test]
fn a_file_is_an_object_too_and_addresses_without_sense_are_refused() {
    let bytes = tower(1.0, 9.0, 4);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.slices");
    std::fs::write(&path, &bytes).unwrap();
    let source = RemoteSource::open(&format!("file://{}", path.display())).unwrap();
    assert_eq!(source.len(), bytes.len() as u64);
    let mut all = vec![0; bytes.len()];
    source.read_at(0, &mut all).unwrap();
    assert_eq!(all, bytes);
    assert!(source.read_at(bytes.len() as u64, &mut [0]).is_err());
    assert!(source.read_at(u64::MAX, &mut [0]).is_err());
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert!(source.read_at(bytes.len() as u64 - 10, &mut [0; 10]).is_err(), "cut");
    for address in ["", "nothing", "ftp://host/a", "s3://bucket/a?key=1", "file:///a?key=1", "file:///no/such/file"] {
        assert!(RemoteSource::open(address).is_err(), "{address}");
    }
}

#[test]
fn the_body_of_a_refusal_is_read_to_a_bound_and_said_in_one_line() {
    let server = Server::new(tower(1.0, 9.0, 4), None);
    server.set(Manner::RefusesAtLength);
    let text = error_of(server.source()).to_string();
    assert!(text.contains("403 Forbidden: <<<") && text.len() < 500, "{text}");
    // The sockets' buffers are filled, even if nothing reads them.
    let refused = server.state.lock().unwrap().refused;
    assert!(refused < 32 << 20, "{refused} bytes were taken");
    server.set(Manner::Refuses("429 Too Many Requests", ""));
    let text = error_of(server.source()).to_string();
    assert!(text.ends_with(r"429 Too Many Requests: <Error> <Code>\u{1b}[31mNo\u{7}</Code> </Error>"), "{text}");
}

#[test]
fn secrets_of_an_address_are_sent_and_never_printed() {
    let server = Server::new(tower(2.0, 30.0, 4), Some("\"one\""));
    let host = server.url.split('/').nth(2).unwrap();
    let address = format!("http://anna:hush%3Ahush@{host}/scans/tower.slices?signature=token");
    let open = || RemoteSource::with(&address, &options());
    let silent = |text: String| assert!(!["anna", "hush", "token"].iter().any(|word| text.contains(word)), "{text}");
    let source = open().unwrap();
    assert_eq!(server.asked(), "GET /scans/tower.slices?signature=token HTTP/1.1");
    assert!(
        server.was_told("authorization: Basic YW5uYTpodXNoOmh1c2g="),
        "{:?}",
        server.state.lock().unwrap().requests
    );
    silent(format!("{source:?}"));
    let manners = [
        Manner::Whole,
        Manner::Short,
        Manner::NotFound,
        Manner::Closes,
        Manner::Fails,
        Manner::OtherRange,
        Manner::OtherTag,
        Manner::Refuses("401 Unauthorized", ""),
        Manner::Refuses("302 Found", "Location: http://anna:hush@127.0.0.1:1/token\r\n"),
    ];
    for manner in manners {
        server.set(manner);
        let errors = [source.read_at(source.len() - 9, &mut [0; 9]).err(), open().err()];
        for error in errors.into_iter().flatten() {
            println!("{manner:?}: {error}");
            silent(format!("{error} {error:?}"));
        }
    }
    for address in ["ftp://anna:hush@host/a", "s3://anna:hush@bucket/a", "http://anna:hush@:x/"] {
        let error = error_of(RemoteSource::open(address));
        silent(format!("{error} {error:?}"));
    }
    let settings = vec![("aws_secret_access_key".to_string(), "hush".to_string())];
    let text = format!("{:?}", RemoteOptions { settings, ..RemoteOptions::default() });
    assert!(text.contains("aws_secret_access_key"), "{text}");
    assert!(!text.contains("hush"), "{text}");
}

#[test]
fn an_asynchronous_task_gets_errors_and_may_drop_a_source() {
    let server = Server::new(tower(2.0, 30.0, 4), None);
    let source = server.source().unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
    runtime.block_on(async {
        let asked = server.count();
        for error in [error_of(server.source()), error_of(source.read_at(source.len() - 9, &mut [0; 9]))] {
            assert!(error.to_string().contains("asynchronous"), "{error}");
        }
        assert_eq!(server.count(), asked);
        drop(source);
    });
}

#[test]
fn an_object_replaced_in_the_middle_of_a_read_is_called_replaced() {
    let server = Server::new(tower(2.0, 30.0, 4), Some("\"one\""));
    let source = server.source().unwrap();
    server.set(Manner::ShortThenReplaced);
    let asked = server.count();
    let text = error_of(source.read_at(20_000, &mut [0; 9000])).to_string();
    assert!(text.contains("replaced"), "{text}");
    assert_eq!(server.count(), asked + 2);
    assert!(server.was_told("if-match: \"one\"") && !server.was_told("range: bytes=20000-28999"), "it is taken up");
}

#[test]
fn the_path_of_an_address_is_sent_as_it_is() {
    let mut server = Server::new(tower(1.0, 9.0, 4), None);
    server.url = server.url.replace("scans/tower", "a%2Fb//c%20d%25/\u{e9}+");
    server.source().unwrap();
    assert_eq!(server.asked(), "GET /a%2Fb//c%20d%25/%C3%A9+.slices HTTP/1.1");
}

#[test]
fn an_answer_without_a_length_is_taken() {
    let bytes = tower(2.0, 30.0, 4);
    let server = Server::new(bytes.clone(), Some("\"one\""));
    // Bytes beyond the range are discarded.
    for more in [0, 5] {
        server.set(Manner::Chunked(more));
        let source = server.source().unwrap();
        let mut all = vec![0; bytes.len()];
        source.read_at(0, &mut all).unwrap();
        assert!(all == bytes, "{more}");
    }
    server.set(Manner::Chunked(-2));
    let text = error_of(server.source()).to_string();
    assert!(text.contains("the answer lacks 2 bytes"), "{text}");
}

#[test]
fn headers_on_which_nothing_depends_may_be_odd() {
    let bytes = tower(2.0, 30.0, 4);
    let server = Server::new(bytes.clone(), Some("\"one\""));
    for lines in [
        "Content-Disposition: attachment; filename=\"H\u{f6}he.laz\"\r\n",
        "Last-Modified: 2026-11-29 10:00:00\r\n",
        "Last-Modified: Sunday, 06-Nov-94 08:49:37 GMT\r\n",
    ] {
        server.set(Manner::Tells(lines));
        let source = server.source().unwrap();
        let mut all = vec![0; bytes.len()];
        source.read_at(0, &mut all).unwrap();
        assert!(all == bytes && server.was_told("if-match: \"one\""), "{lines}");
    }
    // Readable times distinguish versions.
    server.state.lock().unwrap().tag = None;
    server.set(Manner::Tells("Last-Modified: Sun, 06 Nov 1994 08:49:37 GMT\r\n"));
    let source = server.source().unwrap();
    source.read_at(20_000, &mut [0; 1000]).unwrap();
    assert!(server.was_told("if-unmodified-since: Sun, 06 Nov 1994 08:49:37 GMT"));
}

#[test]
fn an_empty_object_is_called_empty() {
    let server = Server::new(tower(1.0, 9.0, 4), None);
    server.set(Manner::Refuses("416 Range Not Satisfiable", "Content-Range: bytes */0\r\n"));
    let text = error_of(server.source()).to_string();
    assert!(text.contains("416 Range Not Satisfiable: the object is empty"), "{text}");
}

#[test]
fn a_server_that_asks_for_a_wait_gets_it_within_the_time_of_a_request() {
    let server = Server::new(tower(2.0, 30.0, 4), None);
    server.set(Manner::RefusesOnce("429 Too Many Requests", "Retry-After: 1\r\n"));
    server.source().unwrap();
    {
        let times = &server.state.lock().unwrap().times;
        assert!(times[1] - times[0] >= Duration::from_secs(1), "{:?}", times[1] - times[0]);
    }
    server.set(Manner::Refuses("503 Service Unavailable", "Retry-After: 3600\r\n"));
    let asked = server.count();
    let text = error_of(server.source()).to_string();
    assert!(text.contains("3600 s"), "{text}");
    assert_eq!(server.count(), asked + 1, "longer than a request may take: not asked again");
}

#[test]
fn an_object_store_is_asked_as_a_server_is() {
    let bytes = tower(2.0, 30.0, 4);
    let server = Server::new(bytes.clone(), Some("\"one\""));
    let endpoint = format!("http://{}", server.url.split('/').nth(2).unwrap());
    let open = |more: &[(&str, &str)]| {
        let common = [("aws_endpoint", &endpoint[..]), ("aws_allow_http", "true"), ("aws_region", "eu-west-1")];
        let settings = common.iter().chain(more).map(|(key, value)| (key.to_string(), value.to_string()));
        RemoteSource::with("s3://scans/a b/tower.slices", &RemoteOptions { settings: settings.collect(), ..options() })
    };
    // Without either, the store would request credentials from the cloud's own address.
    let unsigned = [("aws_skip_signature", "true")];
    let signed = [("aws_access_key_id", "anyone"), ("aws_secret_access_key", "hush")];
    for more in [&unsigned[..], &signed] {
        let source = open(more).unwrap();
        assert_eq!(server.asked(), "GET /scans/a%20b/tower.slices HTTP/1.1");
        let mut all = vec![0; bytes.len()];
        source.read_at(0, &mut all).unwrap();
        assert!(all == bytes);
    }
    server.set(Manner::RefusesOnce("503 Slow Down", "Retry-After: 0\r\n"));
    assert!(open(&unsigned).is_ok());
    server.set(Manner::Refuses("403 Forbidden", ""));
    let text = error_of(open(&signed)).to_string();
    assert!(text.contains("403 Forbidden: <Error>") && !text.contains("hush"), "{text}");
}

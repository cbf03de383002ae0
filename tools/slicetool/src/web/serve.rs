//! `slicetool serve`: serves the page and archives to this machine only.
//!
//! Requests are answered from a table made at the start. Each request opens its archive again, so a replaced archive
//! has another tag, which the page reports. Scans are converted on a thread of their own while the page is served.

use super::conversion::{Conversion, Progress};
use super::page::{INDEX, mime};
use super::ranges::{Wanted, names_tag, wanted};
use super::{CONVERSION, Show, ShowArguments, TABLE};
use crate::{Failure, Outcome, say};
use axum::Router;
use axum::body::Body;
use axum::extract::State;
use axum::http::header::{self, HeaderName, HeaderValue};
use axum::http::{HeaderMap, Method, Response, StatusCode, Uri};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::server::graceful::GracefulShutdown;
use hyper_util::service::TowerToHyperService;
use std::io::{SeekFrom, Write};
use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::io::{AsyncReadExt, AsyncSeekExt};
use tokio::net::TcpListener;
use tokio_util::io::ReaderStream;

/// Time that pending answers get after a request to stop.
const GRACE: Duration = Duration::from_secs(1);
/// Time that a connection gets for the head of its next request.
const HEAD: Duration = Duration::from_secs(10);
/// Bytes of a file held in memory for each answer.
const CHUNK: usize = 1 << 17;
/// Wait for the inputs of a conversion to be opened: until then, a bad one is reported before anything is served.
const OPENING: Duration = Duration::from_secs(2);
/// Time that the page gets to ask for the reason why a conversion failed.
const TELLING: Duration = Duration::from_secs(3);
/// Pause between looks at a conversion.
const LOOK: Duration = Duration::from_millis(20);
/// The page runs its own scripts and wasm, and reads archives from this server and from hosts in its address.
const POLICY: &str = "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; worker-src 'self' blob:; \
                      style-src 'self'; img-src 'self' blob: data:; \
                      connect-src 'self' blob: https: http:; manifest-src 'self'; \
                      base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Options of `slicetool serve`.
#[derive(clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    show: ShowArguments,
    /// Port on 127.0.0.1; 0 takes a free one
    #[arg(long, default_value_t = 0)]
    port: u16,
    /// Open the page in the browser
    #[arg(long)]
    open: bool,
}

/// Resource that a name in an address refers to.
enum Entry {
    Memory(Kept),
    File(PathBuf),
    Conversion(Arc<Converting>),
}

/// A file of the page.
struct Kept {
    bytes: Vec<u8>,
    tag: String,
    /// `bytes` as a gzip stream, made for the first browser that accepts it: a page is larger than what it loads of an
    /// archive before the first step.
    packed: OnceLock<Vec<u8>>,
}

impl Kept {
    fn new(bytes: &[u8]) -> Self {
        let tag = format!("\"{:08x}\"", crc32c::crc32c(bytes));
        Self { bytes: bytes.to_vec(), tag, packed: OnceLock::new() }
    }

    fn packed(&self) -> &[u8] {
        self.packed.get_or_init(|| {
            let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
            packed.write_all(&self.bytes).and_then(|()| packed.finish()).unwrap_or_default()
        })
    }

    /// Answers a request; ranges count in the file itself.
    fn answer(&self, headers: &HeaderMap, name: &str) -> Result<Response<Body>, StatusCode> {
        let packs = takes_gzip(headers) && !headers.contains_key(header::RANGE);
        let (bytes, tag) = match packs {
            true => (self.packed(), format!("{}-gzip\"", self.tag.trim_end_matches('"'))),
            false => (&*self.bytes, self.tag.clone()),
        };
        let about = About { len: bytes.len() as u64, tag, modified: None };
        let (mut head, part) = about.head(headers, name)?;
        head = head.header(header::VARY, "accept-encoding");
        if packs && part.is_some() {
            head = head.header(header::CONTENT_ENCODING, "gzip");
        }
        let body =
            part.map_or(Body::empty(), |part| Body::from(bytes[part.start as usize..part.end as usize].to_vec()));
        head.body(body).map_err(|_| StatusCode::INTERNAL_SERVER_ERROR)
    }
}

/// Returns whether a request accepts answers in gzip: named, and not with a weight of 0.
fn takes_gzip(headers: &HeaderMap) -> bool {
    let values = headers.get_all(header::ACCEPT_ENCODING).iter().filter_map(|value| value.to_str().ok());
    values.flat_map(|value| value.split(',')).any(|coding| {
        let mut parts = coding.split(';').map(str::trim);
        let weight = |part: &str| part.strip_prefix("q=").and_then(|weight| weight.parse::<f32>().ok());
        parts.next().is_some_and(|name| name.eq_ignore_ascii_case("gzip"))
            && parts.all(|part| weight(part) != Some(0.0))
    })
}

struct Table {
    entries: std::collections::BTreeMap<String, Entry>,
}

/// A conversion in progress, and its result.
struct Converting {
    progress: Progress,
    result: OnceLock<Result<(), Failure>>,
    /// True once the page knows that it failed.
    told: AtomicBool,
}

impl Converting {
    /// Begins `conversion`, which is given back at the end.
    fn begin(conversion: Conversion) -> std::io::Result<(Arc<Self>, std::thread::JoinHandle<Conversion>)> {
        let all = Arc::new(Self {
            progress: Progress::new(crate::signal().clone()),
            result: OnceLock::new(),
            told: AtomicBool::new(false),
        });
        let own = all.clone();
        let work = move || {
            let _ = own.result.set(conversion.run(&own.progress));
            conversion
        };
        Ok((all, std::thread::Builder::new().name("conversion".into()).spawn(work)?))
    }

    /// State for the page, as JSON.
    fn state(&self) -> String {
        let (mut converting, mut error) = (serde_json::Value::Null, None);
        match self.result.get() {
            None => {
                let (stage, share) = self.progress.stage_and_share().unwrap_or_else(|| ("opening".into(), 0.0));
                converting = serde_json::json!({ "stage": stage, "share": share });
            }
            Some(Ok(())) => {}
            Some(Err(failure)) => {
                error = Some(failure.text());
                self.told.store(true, Ordering::Relaxed);
            }
        }
        format!("{}\n", serde_json::json!({ "converting": converting, "error": error }))
    }

    fn has_failed(&self) -> bool {
        self.result.get().is_some_and(Result::is_err)
    }

    /// Waits until it has failed and the page knows why, or had the time to ask.
    async fn failed(&self) {
        while !self.has_failed() {
            tokio::time::sleep(LOOK).await;
        }
        let told = async {
            while !self.told.load(Ordering::Relaxed) {
                tokio::time::sleep(LOOK).await;
            }
        };
        let _ = tokio::time::timeout(TELLING, told).await;
    }
}

impl Table {
    fn new(show: Show, converting: Option<&Arc<Converting>>) -> Self {
        let table = show.table(converting.is_some());
        let memory = |bytes: &[u8]| Entry::Memory(Kept::new(bytes));
        let mut entries: std::collections::BTreeMap<_, _> =
            show.page.files().map(|(name, bytes)| (name.to_owned(), memory(bytes))).collect();
        entries.insert(TABLE.into(), memory(table.as_bytes()));
        entries.extend(show.files.into_iter().map(|file| (file.name, Entry::File(file.path))));
        entries.extend(converting.map(|converting| (CONVERSION.into(), Entry::Conversion(converting.clone()))));
        Self { entries }
    }
}

/// Serves until it is interrupted.
pub fn run(arguments: &Arguments) -> Outcome {
    let mut show = Show::new(&arguments.show)?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let (mut begun, mut thread) = (None, None);
    if let Some(conversion) = show.conversion.take() {
        // A port in use is reported before the work.
        drop(runtime.block_on(listen(arguments.port))?);
        let (converting, running) = Converting::begin(conversion)?;
        (begun, thread) = (Some(converting), Some(running));
    }
    let table = Arc::new(Table::new(show, begun.as_ref()));
    let ended = runtime.block_on(serve(arguments, table, begun.as_deref()));
    runtime.shutdown_timeout(GRACE);
    if let (Some(converting), Some(thread)) = (begun, thread) {
        // Ends the work if it still runs; then its files are removed.
        let signal = ended.as_ref().map_or(1, |code| usize::from(code.saturating_sub(128)).max(1));
        converting.progress.signal.store(signal, Ordering::Relaxed);
        if let Ok(conversion) = thread.join() {
            conversion.remove();
        }
        if let (Ok(0), Some(Err(failure))) = (&ended, converting.result.get()) {
            return Err(failure.clone());
        }
    }
    Err(Failure::Interrupted(ended?))
}

async fn listen(port: u16) -> Result<TcpListener, Failure> {
    TcpListener::bind((Ipv4Addr::LOCALHOST, port)).await.map_err(|error| {
        Failure::Text(format!("--port {port}: cannot listen: {error}; choose another port, or 0 for a free one"))
    })
}

/// Serves until a signal comes, and returns its exit code; or until the conversion has failed: 0.
async fn serve(arguments: &Arguments, table: Arc<Table>, converting: Option<&Converting>) -> Result<u8, Failure> {
    let mut signals = Signals::listen()?;
    if let Some(converting) = converting {
        let opened = async {
            while converting.progress.stage_and_share().is_none() && converting.result.get().is_none() {
                tokio::time::sleep(LOOK).await;
            }
        };
        let _ = tokio::time::timeout(OPENING, opened).await;
        if converting.has_failed() {
            return Ok(0);
        }
    }
    let listener = listen(arguments.port).await?;
    let address = format!("http://{}/", listener.local_addr()?);
    let mut out = std::io::stdout();
    // A caller that does not read the address may know it from `--port`.
    let _ = writeln!(out, "{address}").and_then(|()| out.flush());
    if arguments.open
        && let Err(error) = open::that_detached(&address)
    {
        say(&format!("cannot open a browser: {error}; open {address} yourself"));
    }
    let router: Router = Router::new().fallback(answer).with_state(table);
    let connections = GracefulShutdown::new();
    let failed = async {
        match converting {
            Some(converting) => converting.failed().await,
            None => std::future::pending().await,
        }
    };
    let code = first(first(signals.next(), failed), accept(listener, &router, &connections)).await;
    let _ = tokio::time::timeout(GRACE, connections.shutdown()).await;
    Ok(code)
}

/// Answers the requests of all connections, without end.
async fn accept(listener: TcpListener, router: &Router, connections: &GracefulShutdown) {
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            // As with too many open files, until some are closed.
            tokio::time::sleep(LOOK).await;
            continue;
        };
        let mut builder = http1::Builder::new();
        // Only a timer ends connections that never send a whole request.
        builder.timer(TokioTimer::new()).header_read_timeout(HEAD);
        let service = TowerToHyperService::new(router.clone());
        let served = connections.watch(builder.serve_connection(TokioIo::new(stream), service));
        tokio::spawn(async move {
            // A browser that leaves is no failure.
            let _ = served.await;
        });
    }
}

/// Waits for a signal and returns its exit code, or for `failed`: 0.
async fn first(signal: impl Future<Output = u8>, failed: impl Future<Output = ()>) -> u8 {
    let (mut signal, mut failed) = (std::pin::pin!(signal), std::pin::pin!(failed));
    std::future::poll_fn(|context| {
        if let std::task::Poll::Ready(code) = signal.as_mut().poll(context) {
            return std::task::Poll::Ready(code);
        }
        failed.as_mut().poll(context).map(|()| 0)
    })
    .await
}

async fn answer(State(table): State<Arc<Table>>, method: Method, uri: Uri, headers: HeaderMap) -> Response<Body> {
    let mut response = match respond(&table, &method, &uri, &headers).await {
        Ok(response) => response,
        Err(status) => plain(status),
    };
    if method == Method::HEAD {
        *response.body_mut() = Body::empty();
    }
    let always: [(HeaderName, &'static str); 5] = [
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
        // Revalidated every time, because an archive may have been converted again.
        (header::CACHE_CONTROL, "no-cache"),
    ];
    response.headers_mut().extend(always.map(|(name, value)| (name, HeaderValue::from_static(value))));
    response
}

async fn respond(table: &Table, method: &Method, uri: &Uri, headers: &HeaderMap) -> Result<Response<Body>, StatusCode> {
    if !is_own_host(uri, headers) {
        return Err(StatusCode::FORBIDDEN);
    }
    if method != Method::GET && method != Method::HEAD {
        let mut response = plain(StatusCode::METHOD_NOT_ALLOWED);
        response.headers_mut().insert(header::ALLOW, HeaderValue::from_static("GET, HEAD"));
        return Ok(response);
    }
    let path = percent_encoding::percent_decode_str(uri.path().trim_start_matches('/')).decode_utf8();
    let name = path.map_err(|_| StatusCode::NOT_FOUND)?;
    let name = if name.is_empty() { INDEX } else { &name };
    match table.entries.get(name).ok_or(StatusCode::NOT_FOUND)? {
        Entry::Conversion(converting) => {
            let mut response = Response::new(Body::from(converting.state()));
            response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static(mime(CONVERSION)));
            Ok(response)
        }
        Entry::Memory(kept) => kept.answer(headers, name),
        Entry::File(path) => {
            let (mut file, about) = About::open(path).await.map_err(|error| missing(path, &error))?;
            let (head, part) = about.head(headers, name)?;
            let body = match part {
                None => Body::empty(),
                Some(part) => {
                    file.seek(SeekFrom::Start(part.start)).await.map_err(|error| missing(path, &error))?;
                    Body::from_stream(ReaderStream::with_capacity(file.take(part.end - part.start), CHUNK))
                }
            };
            head.body(body).map_err(|_| StatusCode::INTERNAL_SERVER_ERROR)
        }
    }
}

/// Reports that a served file can no longer be read.
fn missing(path: &Path, error: &std::io::Error) -> StatusCode {
    say(&format!("{}: cannot read: {error}", path.display()));
    match error.kind() {
        std::io::ErrorKind::NotFound => StatusCode::NOT_FOUND,
        _ => StatusCode::INTERNAL_SERVER_ERROR,
    }
}

/// Returns whether a request names this machine; a foreign site whose name resolves to 127.0.0.1 does not (DNS
/// rebinding). HTTP/2 names it in the address instead of a header; a request that names none is refused.
fn is_own_host(uri: &Uri, headers: &HeaderMap) -> bool {
    let in_headers = headers.get_all(header::HOST).iter().map(|host| host.to_str().unwrap_or(""));
    let in_address = uri.authority().map(|authority| authority.as_str());
    let is_own = |host: &str| {
        let name = host
            .rsplit_once(':')
            .filter(|(_, port)| port.bytes().all(|b| b.is_ascii_digit()))
            .map_or(host, |(name, _)| name);
        name == "127.0.0.1" || name.eq_ignore_ascii_case("localhost")
    };
    let mut hosts = in_headers.chain(in_address).peekable();
    hosts.peek().is_some() && hosts.all(is_own)
}

fn plain(status: StatusCode) -> Response<Body> {
    let mut response = Response::new(Body::from(format!("{status}\n")));
    *response.status_mut() = status;
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static(mime("status.txt")));
    response
}

/// Metadata of a file in an answer.
struct About {
    len: u64,
    tag: String,
    modified: Option<SystemTime>,
}

impl About {
    /// Opens the file at `path`. Its tag combines length, modification time and a checksum of its head, which is
    /// written last and differs between archives.
    async fn open(path: &Path) -> std::io::Result<(tokio::fs::File, Self)> {
        const HEAD_BYTES: u64 = 16_384;
        let mut file = tokio::fs::File::open(path).await?;
        let about = file.metadata().await?;
        let mut head = Vec::new();
        (&mut file).take(HEAD_BYTES).read_to_end(&mut head).await?;
        let modified = about.modified().ok();
        let nanoseconds =
            modified.and_then(|time| time.duration_since(UNIX_EPOCH).ok()).map_or(0, |age| age.as_nanos());
        let tag = format!("\"{:x}-{nanoseconds:x}-{:08x}\"", about.len(), crc32c::crc32c(&head));
        Ok((file, Self { len: about.len(), tag, modified }))
    }

    /// Status and headers of the answer to a request with these headers, and the range of bytes to send.
    fn head(
        &self,
        request: &HeaderMap,
        name: &str,
    ) -> Result<(axum::http::response::Builder, Option<std::ops::Range<u64>>), StatusCode> {
        let text = |name: HeaderName| request.get(name).and_then(|value| value.to_str().ok());
        let date = self.modified.map(httpdate::fmt_http_date);
        let mut head = Response::builder()
            .header(header::ETAG, &self.tag)
            .header(header::ACCEPT_RANGES, "bytes")
            .header(header::CONTENT_TYPE, mime(name));
        if let Some(date) = &date {
            head = head.header(header::LAST_MODIFIED, date);
        }
        if text(header::IF_MATCH).is_some_and(|tags| !names_tag(tags, &self.tag)) {
            return Err(StatusCode::PRECONDITION_FAILED);
        }
        let unchanged = match text(header::IF_NONE_MATCH) {
            Some(tags) => names_tag(tags, &self.tag),
            None => date.is_some() && text(header::IF_MODIFIED_SINCE) == date.as_deref(),
        };
        if unchanged {
            return Ok((head.status(StatusCode::NOT_MODIFIED), None));
        }
        // A part of another version is useless, so the answer is then the whole new file.
        let same = text(header::IF_RANGE).is_none_or(|known| known == self.tag || Some(known) == date.as_deref());
        let (status, part) = match wanted(text(header::RANGE).filter(|_| same), self.len) {
            Wanted::Whole => (StatusCode::OK, 0..self.len),
            Wanted::Part(part) => {
                let range = format!("bytes {}-{}/{}", part.start, part.end - 1, self.len);
                head = head.header(header::CONTENT_RANGE, range);
                (StatusCode::PARTIAL_CONTENT, part)
            }
            Wanted::Outside => {
                let range = format!("bytes */{}", self.len);
                let head = head.header(header::CONTENT_RANGE, range).header(header::CONTENT_LENGTH, 0);
                return Ok((head.status(StatusCode::RANGE_NOT_SATISFIABLE), None));
            }
        };
        Ok((head.status(status).header(header::CONTENT_LENGTH, part.end - part.start), Some(part)))
    }
}

/// Signals that stop the server.
#[cfg(unix)]
struct Signals([(u8, tokio::signal::unix::Signal); 3]);

#[cfg(unix)]
impl Signals {
    fn listen() -> std::io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self([
            (130, signal(SignalKind::interrupt())?),
            (143, signal(SignalKind::terminate())?),
            (129, signal(SignalKind::hangup())?),
        ]))
    }

    /// Waits for the next signal and returns its exit code.
    async fn next(&mut self) -> u8 {
        std::future::poll_fn(|context| {
            let come =
                self.0.iter_mut().find_map(|(code, signal)| signal.poll_recv(context).is_ready().then_some(*code));
            come.map_or(std::task::Poll::Pending, std::task::Poll::Ready)
        })
        .await
    }
}

#[cfg(not(unix))]
struct Signals;

#[cfg(not(unix))]
impl Signals {
    fn listen() -> std::io::Result<Self> {
        Ok(Self)
    }

    async fn next(&mut self) -> u8 {
        let _ = tokio::signal::ctrl_c().await;
        130
    }
}

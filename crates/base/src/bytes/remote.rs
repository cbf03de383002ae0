//! Archives on web servers and in object stores, read by ranges.
//!
//! The first request fetches the first 16 KiB together with length and version (ETag) of the object; opening an archive
//! then takes one more, for its footer. All later requests ask for exactly that version, so an object that is replaced
//! while it is open gives an error, never a mixture. The version in each answer is checked as well.
//!
//! Messages name the address without user, password and query; of an answer they print the status and one line.

mod connect;
mod list;
mod pool;
mod text;
mod transport;
mod upload;

pub use list::list;
pub use upload::{check_upload, upload};

use super::{ByteSource, FileId, Stamp, stop_of_thread};
use crate::{Error, Result};
use connect::{Connected, Use, connect};
use futures_util::StreamExt;
use object_store::client::HttpError;
use object_store::{GetOptions, GetRange, ObjectMeta};
use std::cell::Cell;
use std::io;
use std::ops::Range;
use std::pin::pin;
use std::time::{Duration, Instant};
use text::{cause, connection, one_line, public_name};
use tokio::runtime::Handle;
use transport::Refusal;
use url::Url;

/// Bytes fetched by the first request: the longest head of an archive.
const FIRST: u64 = 16 << 10;

/// Interval between checks of the time limits and of cancellation.
const LOOK: Duration = Duration::from_millis(20);

/// Wait before the first retry of a request; it doubles up to 64 times this.
const WAIT: Duration = Duration::from_millis(50);

/// Options for access to an object.
#[derive(Clone, PartialEq, Eq)]
pub struct RemoteOptions {
    /// Longest time a request waits for the next bytes, connecting included, and longest wait (`Retry-After`) that a
    /// server may ask for before the request is retried. If the server asks for more, the read fails at once.
    pub timeout: Duration,
    /// Longest time a read waits for the next bytes, retries included. A request that timed out is retried only if this
    /// is longer than `timeout`.
    pub patience: Duration,
    /// Retries of a request that failed for a possibly temporary reason: a lost connection, an error of the server.
    pub retries: usize,
    /// Settings of the object store by name, for example `("aws_endpoint", ...)`, in addition to `AWS_*`, `GOOGLE_*` or
    /// `AZURE_*` from the environment. If neither holds credentials, requests are not signed.
    pub settings: Vec<(String, String)>,
}

impl Default for RemoteOptions {
    /// 10 s for a request and for a read, eight retries, no settings.
    fn default() -> Self {
        let wait = Duration::from_secs(10);
        Self { timeout: wait, patience: wait, retries: 8, settings: Vec::new() }
    }
}

/// Shows only the names of the settings, because values may be secret.
impl std::fmt::Debug for RemoteOptions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let names: Vec<&str> = self.settings.iter().map(|(name, _)| &name[..]).collect();
        let Self { timeout, patience, retries, settings: _ } = self;
        f.debug_struct("RemoteOptions")
            .field("timeout", timeout)
            .field("patience", patience)
            .field("retries", retries)
            .field("settings", &names)
            .finish()
    }
}

/// Object on a web server or in an object store.
///
/// Reads block the calling thread: give the archive to a `Stream` of `slicewalk`, whose thread does the
/// waiting, or make the thread [`interruptible`](super::interruptible). All objects of a server or bucket that are
/// opened with the same options share one client, with as many connections as there are concurrent reads; connections
/// stay open for later reads. Memory: 16 KiB, and the connection's.
pub struct RemoteSource {
    connected: Connected,
    /// Address for messages, without password and query.
    name: String,
    options: RemoteOptions,
    first: Vec<u8>,
    meta: ObjectMeta,
}

impl RemoteSource {
    /// Opens the object at `url`: `https://`, `http://`, `s3://bucket/key` (and addresses of Amazon S3 and Cloudflare
    /// R2), `gs://bucket/key`, `az://container/key`, or `file://`. Cost: one request. Addresses of web servers are used
    /// unchanged: a query (a signed address) is part of every request, and `user:password@` is sent as basic
    /// authentication; no message prints either.
    pub fn open(url: &str) -> Result<Self> {
        Self::with(url, &RemoteOptions::default())
    }

    /// Like [`open`](Self::open), with options.
    ///
    /// Fails if the address is not understood, the object does not exist, the server does not support ranges, or the
    /// calling thread belongs to an asynchronous runtime (reads block; use a thread of your own). After a `fork`, open
    /// it again: the connections belong to the process that opened it, and reads fail in another.
    pub fn with(url: &str, options: &RemoteOptions) -> Result<Self> {
        let refused = |reason: String| Error::parameter("address of a remote archive", reason);
        let url = Url::parse(url).map_err(|error| refused(error.to_string()))?;
        let name = public_name(&url);
        refuse_tasks(&name)?;
        let connected = connect(url, options, Use::READ).map_err(refused)?;
        let meta = ObjectMeta {
            location: connected.path.clone(),
            last_modified: Default::default(),
            size: u64::MAX,
            e_tag: None,
            version: None,
        };
        let mut source = Self { connected, name, options: options.clone(), first: Vec::new(), meta };
        let (meta, first) = source.get(0..FIRST, None)?;
        (source.meta, source.first) = (meta, first);
        Ok(source)
    }

    /// Returns the version that was opened.
    pub(super) fn stamp(&self) -> Stamp {
        let ObjectMeta { size, last_modified, e_tag, version, .. } = &self.meta;
        let hash = |bytes: &[u8]| xxhash_rust::xxh3::xxh3_64(bytes);
        let version = format!("{e_tag:?} {version:?}");
        let id = FileId::of_object(hash(self.name.as_bytes()), hash(version.as_bytes()));
        // Without a time from the server, this is the epoch.
        let modified = (last_modified.timestamp() > 0).then(|| (*last_modified).into());
        Stamp::of_object(*size, modified, id)
    }

    /// Returns whether the first request fetched all bytes before `end`.
    pub(super) fn holds(&self, end: u64) -> bool {
        end <= self.first.len() as u64
    }

    /// Fetches the bytes of `range` that the object has, in the version `known`, or in any version.
    fn get(&self, range: Range<u64>, known: Option<&ObjectMeta>) -> Result<(ObjectMeta, Vec<u8>)> {
        refuse_tasks(&self.name)?;
        let (mut meta, mut bytes) = (known.cloned(), Vec::with_capacity((range.end - range.start) as usize));
        let (mut failures, heard) = (0, Cell::new(Instant::now()));
        loop {
            let asked = self.within_time(&heard, self.ask(&range, &mut meta, &mut bytes, &heard));
            let answer = self.connected.wait_for(asked);
            let failure = match answer.map_err(|error| Error::io(&self.name, reading(&range), error))? {
                Ok(meta) => return Ok((meta, bytes)),
                Err(Failure::Stopped) => return Err(Error::Interrupted),
                Err(failure) => failure,
            };
            let wait = failure.wait(failures, self.options.timeout);
            let lasts = |wait: &Duration| {
                failures < self.options.retries
                    && (failure.is_answer() || heard.get().elapsed() + *wait < self.options.patience)
            };
            let Some(wait) = wait.filter(lasts) else {
                let action = if known.is_none() { "open".to_owned() } else { reading(&range) };
                let error = io::Error::from(failure);
                return Err(Error::io(&self.name, action, self.connected.explained(error)));
            };
            failures += 1;
            sleep(wait)?;
            if failure.is_answer() {
                heard.set(Instant::now());
            }
        }
    }

    /// Awaits a request, unless its thread is cancelled or no bytes arrive for too long.
    async fn within_time<T>(
        &self,
        heard: &Cell<Instant>,
        request: impl Future<Output = Result<T, Failure>>,
    ) -> Result<T, Failure> {
        let (mut request, began, stop) = (pin!(request), Instant::now(), stop_of_thread());
        let RemoteOptions { timeout, patience, .. } = self.options;
        loop {
            if let Ok(answer) = tokio::time::timeout(LOOK, request.as_mut()).await {
                return answer;
            }
            if stop.as_ref().is_some_and(|stop| stop()) {
                return Err(Failure::Stopped);
            }
            if began.max(heard.get()).elapsed() >= timeout {
                return Err(Failure::Silent(timeout));
            }
            if heard.get().elapsed() >= patience {
                return Err(Failure::Silent(patience));
            }
        }
    }

    /// Sends one request for the part of `range` missing in `bytes`; sets `meta` with the first answer.
    async fn ask(
        &self,
        range: &Range<u64>,
        meta: &mut Option<ObjectMeta>,
        bytes: &mut Vec<u8>,
        heard: &Cell<Instant>,
    ) -> Result<ObjectMeta, Failure> {
        let mut options = meta.as_ref().map_or(GetOptions::default(), same_version);
        // Resume an aborted read where it stopped if that version can be requested; else start again.
        if options.if_match.is_none() && options.if_unmodified_since.is_none() {
            bytes.clear();
        }
        let start = range.start + bytes.len() as u64;
        options.range = Some(GetRange::Bounded(start..range.end));
        let answer = self.connected.store.get_opts(&self.connected.path, options).await?;
        let found = answer.meta.clone();
        let version = |meta: &ObjectMeta| (meta.size, meta.e_tag.clone(), meta.last_modified);
        if meta.as_ref().is_some_and(|known| version(known) != version(&found)) {
            return Err(Failure::Replaced);
        }
        *meta = Some(found.clone());
        let end = range.end.min(found.size);
        let mut stream = answer.into_stream();
        while let Some(part) = stream.next().await {
            let part = part?;
            heard.set(Instant::now());
            // Discard bytes beyond the range.
            let left = (end - range.start) as usize - bytes.len();
            bytes.extend_from_slice(&part[..part.len().min(left)]);
            if part.len() > left {
                break;
            }
        }
        let missing = end - range.start - bytes.len() as u64;
        if missing > 0 { Err(Failure::Short { missing }) } else { Ok(found) }
    }
}

impl ByteSource for RemoteSource {
    fn len(&self) -> u64 {
        self.meta.size
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        let end = offset.saturating_add(buf.len() as u64);
        if end > self.meta.size {
            return Err(Error::io(&self.name, reading(&(offset..end)), io::ErrorKind::UnexpectedEof.into()));
        }
        if end <= self.first.len() as u64 {
            buf.copy_from_slice(&self.first[offset as usize..end as usize]);
            return Ok(());
        }
        let (_, bytes) = self.get(offset..end, Some(&self.meta))?;
        buf.copy_from_slice(&bytes);
        Ok(())
    }

    fn address(&self) -> Option<&str> {
        Some(&self.name)
    }
}

impl std::fmt::Debug for RemoteSource {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RemoteSource").field("name", &self.name).field("meta", &self.meta).finish_non_exhaustive()
    }
}

/// Reason why a read failed.
enum Failure {
    Replaced,
    /// The answer ended regularly, but too early.
    Short {
        missing: u64,
    },
    /// No bytes arrived for this long.
    Silent(Duration),
    /// The thread was cancelled.
    Stopped,
    Store(object_store::Error),
}

impl Failure {
    /// Returns how long to wait before a retry after `failures` failures; `None` if a retry is of no use.
    fn wait(&self, failures: usize, longest: Duration) -> Option<Duration> {
        let own = WAIT * (1 << failures.min(6));
        let error = match self {
            Self::Store(error) => error,
            Self::Silent(_) => return Some(own),
            _ => return None,
        };
        match cause::<Refusal>(error) {
            Some(refusal) if !refusal.may_pass() => None,
            Some(refusal) => {
                Some(refusal.wait.map_or(own, |asked| asked.max(own))).filter(|&wait| wait <= longest.max(own))
            }
            None => cause::<HttpError>(error).map(|_| own),
        }
    }

    /// Returns whether the server answered, even if only with a refusal.
    fn is_answer(&self) -> bool {
        matches!(self, Self::Store(error) if cause::<Refusal>(error).is_some())
    }
}

impl From<object_store::Error> for Failure {
    fn from(error: object_store::Error) -> Self {
        let replaced = matches!(error, object_store::Error::Precondition { .. })
            || cause::<Refusal>(&error).is_some_and(Refusal::is_replaced);
        if replaced { Self::Replaced } else { Self::Store(error) }
    }
}

/// Keeps only the text, because errors of the store hold addresses.
impl From<Failure> for io::Error {
    fn from(failure: Failure) -> Self {
        let error = match failure {
            Failure::Replaced => {
                return Self::other("the object was replaced since it was opened; open it again");
            }
            Failure::Short { missing } => {
                return Self::new(io::ErrorKind::UnexpectedEof, format!("the answer lacks {missing} bytes"));
            }
            Failure::Silent(time) => {
                let reason =
                    format!("no answer within {} s; give it more time, or try again later", time.as_secs_f64());
                return Self::new(io::ErrorKind::TimedOut, reason);
            }
            Failure::Stopped => return Self::other("was asked to stop"),
            Failure::Store(error) => error,
        };
        if let Some(refusal) = cause::<Refusal>(&error) {
            return match refusal.kind() {
                io::ErrorKind::NotFound => Self::new(io::ErrorKind::NotFound, format!("no such object ({refusal})")),
                kind => Self::new(kind, refusal.to_string()),
            };
        }
        if let Some(error) = cause::<HttpError>(&error) {
            return Self::other(connection(error));
        }
        match error {
            object_store::Error::NotFound { .. } => Self::new(io::ErrorKind::NotFound, "there is no such object"),
            error @ (object_store::Error::PermissionDenied { .. } | object_store::Error::Unauthenticated { .. }) => {
                Self::new(io::ErrorKind::PermissionDenied, one_line(&error.to_string()))
            }
            other => Self::other(one_line(&other.to_string())),
        }
    }
}

/// Awaits `work`, unless this thread is cancelled.
async fn unless_stopped<T>(work: impl Future<Output = T>) -> Result<T> {
    let (mut work, stop) = (pin!(work), stop_of_thread());
    loop {
        if let Ok(done) = tokio::time::timeout(LOOK, work.as_mut()).await {
            return Ok(done);
        }
        if stop.as_ref().is_some_and(|stop| stop()) {
            return Err(Error::Interrupted);
        }
    }
}

/// Sleeps, unless this thread is cancelled.
fn sleep(time: Duration) -> Result<()> {
    let (until, stop) = (Instant::now() + time, stop_of_thread());
    loop {
        let rest = until.saturating_duration_since(Instant::now());
        if rest.is_zero() {
            return Ok(());
        }
        if stop.as_ref().is_some_and(|stop| stop()) {
            return Err(Error::Interrupted);
        }
        std::thread::sleep(rest.min(LOOK));
    }
}

fn reading(range: &Range<u64>) -> String {
    format!("read {} bytes at {}", range.end - range.start, range.start)
}

/// Refuses threads of an asynchronous runtime, which must not block.
fn refuse_tasks(name: &str) -> Result<()> {
    if Handle::try_current().is_err() {
        return Ok(());
    }
    let reason = "was asked for in an asynchronous task, which must not block; use a thread of your own";
    Err(Error::parameter(name, reason))
}

/// Requests the version of `meta`, if the server supports that.
fn same_version(meta: &ObjectMeta) -> GetOptions {
    // A weak tag never matches; then the modification time is used, if the server states it.
    let strong = meta.e_tag.clone().filter(|tag| !tag.starts_with("W/"));
    let time = Some(meta.last_modified).filter(|time| strong.is_none() && time.timestamp() > 0);
    GetOptions { if_match: strong, if_unmodified_since: time, ..GetOptions::default() }
}

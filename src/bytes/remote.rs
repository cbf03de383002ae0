//! Archives on web servers and in object stores, read by ranges.
//!
//! The first request fetches the first 16 KiB, and with them length and version (ETag) of the object; opening an archive
//! then takes one more, for its footer. All later requests ask for that very version, so an object that is replaced
//! while it is open gives an error, never a mixture; what a server says about the version is checked besides.

use super::ByteSource;
use crate::{Error, Result};
use futures_util::StreamExt;
use object_store::aws::AmazonS3Builder;
use object_store::http::HttpBuilder;
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{
    BackoffConfig, ClientOptions, GetOptions, GetRange, ObjectMeta, ObjectStore, ObjectStoreScheme, RetryConfig,
};
use std::io;
use std::time::Duration;
use tokio::runtime::{Builder, Handle, Runtime};
use url::{Position, Url};

/// Bytes that come with the first request: the longest head of an archive.
const FIRST: u64 = 16 << 10;

/// How to reach an object.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RemoteOptions {
    /// Longest time of one request (s), connecting included.
    pub timeout: Duration,
    /// How often a request is repeated that failed for a reason which may pass: a lost connection, an error of the server.
    pub retries: usize,
    /// Settings of the object store by name, for example `("aws_endpoint", ...)`; for S3 these come on top of the
    /// environment's `AWS_*`.
    pub settings: Vec<(String, String)>,
}

impl Default for RemoteOptions {
    /// 10 s, three repetitions, no settings.
    fn default() -> Self {
        Self { timeout: Duration::from_secs(10), retries: 3, settings: Vec::new() }
    }
}

/// An object on a web server or in an object store.
///
/// Reads block the calling thread: give the archive to a [`Stream`](super::Stream), whose thread does the waiting. Memory:
/// 16 KiB, and the connection's.
pub struct RemoteSource {
    store: Box<dyn ObjectStore>,
    path: Path,
    /// For messages: no password, no query.
    name: String,
    runtime: Runtime,
    first: Vec<u8>,
    meta: ObjectMeta,
}

impl RemoteSource {
    /// Opens the object at `url`: `https://`, `http://`, `s3://bucket/key` (and addresses of Amazon S3 and Cloudflare R2), or
    /// `file://`. One request. A query in the address is refused: servers that sign addresses need settings instead.
    pub fn open(url: &str) -> Result<Self> {
        Self::with(url, &RemoteOptions::default())
    }

    /// As [`open`](Self::open), with options.
    ///
    /// Fails if the address is not understood, the object is not there, the server does not give ranges, or the caller is an
    /// asynchronous task (reads block).
    pub fn with(url: &str, options: &RemoteOptions) -> Result<Self> {
        let refused = |reason: String| Error::parameter("address of a remote archive", reason);
        let url = Url::parse(url).map_err(|error| refused(error.to_string()))?;
        if url.query().is_some() {
            return Err(refused("has a query; give the settings of the store instead".into()));
        }
        let (scheme, path) = ObjectStoreScheme::parse(&url).map_err(|error| refused(error.to_string()))?;
        let store = connect(&scheme, &url, options).map_err(|error| refused(error.to_string()))?;
        let name = format!("{}://{}{}", url.scheme(), &url[Position::BeforeHost..Position::AfterPort], url.path());
        let runtime = Builder::new_current_thread().enable_all().build();
        let runtime = runtime.map_err(|error| Error::io(&name, "start its runtime", error))?;
        let meta = ObjectMeta {
            location: path.clone(),
            last_modified: Default::default(),
            size: u64::MAX,
            e_tag: None,
            version: None,
        };
        let mut source = Self { store, path, name, runtime, first: Vec::new(), meta };
        let options = GetOptions { range: Some(GetRange::Bounded(0..FIRST)), ..GetOptions::default() };
        let (meta, first) = source.get(options, FIRST as usize, 0)?;
        if first.len() as u64 != meta.size.min(FIRST) {
            return Err(source.error(0, first.len(), io::ErrorKind::UnexpectedEof.into()));
        }
        (source.meta, source.first) = (meta, first);
        Ok(source)
    }

    /// Asks for bytes: at most `len` of them, from `offset` on.
    fn get(&self, options: GetOptions, len: usize, offset: u64) -> Result<(ObjectMeta, Vec<u8>)> {
        if Handle::try_current().is_ok() {
            let reason = "was asked for in an asynchronous task, which must not block; use a thread";
            return Err(Error::parameter(self.name.clone(), reason));
        }
        let answer = self.runtime.block_on(async {
            let result = self.store.get_opts(&self.path, options).await?;
            let meta = result.meta.clone();
            let mut bytes = Vec::with_capacity(len);
            let mut stream = result.into_stream();
            while let Some(part) = stream.next().await {
                let part = part?;
                let left = len - bytes.len();
                // More than was asked for is not kept; the length tells.
                bytes.extend_from_slice(&part[..part.len().min(left)]);
                if part.len() > left {
                    break;
                }
            }
            Ok((meta, bytes))
        });
        answer.map_err(|error: object_store::Error| self.error(offset, len, io_error(error)))
    }

    fn error(&self, offset: u64, len: usize, error: io::Error) -> Error {
        Error::io(&self.name, format!("read {len} bytes at {offset}"), error)
    }

    /// Asks for the version that was opened.
    fn same_version(&self) -> GetOptions {
        // A weak tag never matches; then the time of the last change has to do, if the server tells it.
        let strong = self.meta.e_tag.clone().filter(|tag| !tag.starts_with("W/"));
        let time = Some(self.meta.last_modified).filter(|time| strong.is_none() && time.timestamp() > 0);
        GetOptions { if_match: strong, if_unmodified_since: time, ..GetOptions::default() }
    }
}

impl ByteSource for RemoteSource {
    fn len(&self) -> u64 {
        self.meta.size
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        let end = offset.checked_add(buf.len() as u64).filter(|&end| end <= self.meta.size);
        let Some(end) = end else { return Err(self.error(offset, buf.len(), io::ErrorKind::UnexpectedEof.into())) };
        if end <= self.first.len() as u64 {
            buf.copy_from_slice(&self.first[offset as usize..end as usize]);
            return Ok(());
        }
        let options = GetOptions { range: Some(GetRange::Bounded(offset..end)), ..self.same_version() };
        let (meta, bytes) = self.get(options, buf.len(), offset)?;
        let version = |meta: &ObjectMeta| (meta.size, meta.e_tag.clone(), meta.last_modified);
        if version(&meta) != version(&self.meta) {
            return Err(self.error(offset, buf.len(), replaced()));
        }
        if bytes.len() != buf.len() {
            return Err(self.error(offset, buf.len(), io::ErrorKind::UnexpectedEof.into()));
        }
        buf.copy_from_slice(&bytes);
        Ok(())
    }
}

impl std::fmt::Debug for RemoteSource {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RemoteSource").field("name", &self.name).field("meta", &self.meta).finish_non_exhaustive()
    }
}

fn connect(
    scheme: &ObjectStoreScheme,
    url: &Url,
    options: &RemoteOptions,
) -> object_store::Result<Box<dyn ObjectStore>> {
    let backoff = BackoffConfig { init_backoff: Duration::from_millis(50), ..BackoffConfig::default() };
    let retry = RetryConfig { backoff, max_retries: options.retries, retry_timeout: 3 * options.timeout };
    let client = ClientOptions::new().with_timeout(options.timeout).with_connect_timeout(options.timeout);
    Ok(match scheme {
        ObjectStoreScheme::Local => Box::new(LocalFileSystem::new()),
        ObjectStoreScheme::Http => {
            let client = client.with_allow_http(url.scheme() == "http");
            let server = HttpBuilder::new().with_url(&url[..Position::BeforePath]);
            Box::new(server.with_client_options(client).with_retry(retry).build()?)
        }
        ObjectStoreScheme::AmazonS3 => {
            let mut builder =
                AmazonS3Builder::from_env().with_client_options(client).with_retry(retry).with_url(url.as_str());
            for (key, value) in &options.settings {
                builder = builder.with_config(key.to_ascii_lowercase().parse()?, value);
            }
            Box::new(builder.build()?)
        }
        other => {
            let source = format!("{other:?} is not supported; use http(s), s3 or file").into();
            return Err(object_store::Error::Generic { store: "remote", source });
        }
    })
}

fn replaced() -> io::Error {
    io::Error::other("the object was replaced since it was opened; open it again")
}

fn io_error(error: object_store::Error) -> io::Error {
    match error {
        object_store::Error::Precondition { .. } => replaced(),
        object_store::Error::NotFound { .. } => io::Error::new(io::ErrorKind::NotFound, "there is no such object"),
        object_store::Error::PermissionDenied { .. } | object_store::Error::Unauthenticated { .. } => {
            io::Error::new(io::ErrorKind::PermissionDenied, error)
        }
        other => io::Error::other(other),
    }
}

//! Archives on web servers and in object stores, read by ranges.
//!
//! The first request fetches the first 16 KiB, and with them length and version (ETag) of the object; opening an archive
//! then takes one more, for its footer. All later requests ask for that very version, so an object that is replaced
//! while it is open gives an error, never a mixture; what a server says about the version is checked besides.
//!
//! Errors name the address without user, password and query, and print of an answer its status and one line.

#[cfg(feature = "convert")]
mod list;
mod text;
mod transport;
mod upload;

#[cfg(feature = "convert")]
pub(crate) use list::list;
pub(crate) use upload::{check_upload, upload};

use super::{ByteSource, FileId, Stamp};
use crate::{Error, Result};
use base64::Engine;
use futures_util::StreamExt;
use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
#[cfg(feature = "clouds")]
use object_store::azure::{AzureConfigKey, MicrosoftAzureBuilder};
use object_store::client::HttpError;
#[cfg(feature = "clouds")]
use object_store::gcp::{GoogleCloudStorageBuilder, GoogleConfigKey};
use object_store::http::HttpBuilder;
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{
    ClientOptions, GetOptions, GetRange, HeaderValue, ObjectMeta, ObjectStore, ObjectStoreScheme, RetryConfig,
};
use percent_encoding::percent_decode_str;
use std::io;
use std::ops::Range;
use std::time::Duration;
use text::{cause, connection, one_line, public_name};
use tokio::runtime::{Builder, Handle, Runtime};
use transport::{Connector, Refusal};
use url::Url;

/// Bytes that come with the first request: the longest head of an archive.
const FIRST: u64 = 16 << 10;

/// The wait before the first repetition of a request; it doubles up to 64 times this.
const WAIT: Duration = Duration::from_millis(50);

/// How to reach an object.
#[derive(Clone, PartialEq, Eq)]
pub struct RemoteOptions {
    /// Longest time of one request (s), connecting included, and longest wait that a server may ask for (`Retry-After`)
    /// before the request is repeated; if it asks for more, the read fails at once.
    pub timeout: Duration,
    /// How often a request is repeated that failed for a reason which may pass: a lost connection, an error of the server.
    /// So a read fails after `(2 · retries + 1) · timeout` at the latest.
    pub retries: usize,
    /// Settings of the object store by name, for example `("aws_endpoint", ...)`; these come on top of the environment's
    /// `AWS_*`, `GOOGLE_*` or `AZURE_*`. If neither holds credentials, requests are not signed.
    pub settings: Vec<(String, String)>,
}

impl Default for RemoteOptions {
    /// 10 s, three repetitions, no settings.
    fn default() -> Self {
        Self { timeout: Duration::from_secs(10), retries: 3, settings: Vec::new() }
    }
}

/// Names of the settings only: values may be secret.
impl std::fmt::Debug for RemoteOptions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let names: Vec<&str> = self.settings.iter().map(|(name, _)| &name[..]).collect();
        let Self { timeout, retries, settings: _ } = self;
        f.debug_struct("RemoteOptions")
            .field("timeout", timeout)
            .field("retries", retries)
            .field("settings", &names)
            .finish()
    }
}

/// An object on a web server or in an object store.
///
/// Reads block the calling thread: give the archive to a [`Stream`](crate::store::Stream), whose thread does the waiting.
/// Memory: 16 KiB, and the connection's.
pub struct RemoteSource {
    store: Box<dyn ObjectStore>,
    path: Path,
    unsigned: bool,
    /// For messages: no password, no query.
    name: String,
    options: RemoteOptions,
    /// `None` only while it is dropped.
    runtime: Option<Runtime>,
    first: Vec<u8>,
    meta: ObjectMeta,
}

impl RemoteSource {
    /// Opens the object at `url`: `https://`, `http://`, `s3://bucket/key` (and addresses of Amazon S3 and Cloudflare R2),
    /// `gs://bucket/key`, `az://container/key`, or `file://`. One request. Addresses of web servers are used as they are: a query (a signed address) is part of every
    /// request, `user:password@` is sent as basic authentication; no message prints either.
    pub fn open(url: &str) -> Result<Self> {
        Self::with(url, &RemoteOptions::default())
    }

    /// As [`open`](Self::open), with options.
    ///
    /// Fails if the address is not understood, the object is not there, the server does not give ranges, or the calling
    /// thread belongs to an asynchronous runtime (reads block; use a thread of your own).
    pub fn with(url: &str, options: &RemoteOptions) -> Result<Self> {
        let refused = |reason: String| Error::parameter("address of a remote archive", reason);
        let url = Url::parse(url).map_err(|error| refused(error.to_string()))?;
        let name = public_name(&url);
        refuse_tasks(&name)?;
        let Connected { store, path, unsigned } = connect(url, options, Use::READ).map_err(refused)?;
        let runtime = Builder::new_current_thread().enable_all().build();
        let runtime = Some(runtime.map_err(|error| Error::io(&name, "start its runtime", error))?);
        let meta = ObjectMeta {
            location: path.clone(),
            last_modified: Default::default(),
            size: u64::MAX,
            e_tag: None,
            version: None,
        };
        let mut source =
            Self { store, path, unsigned, name, options: options.clone(), runtime, first: Vec::new(), meta };
        let (meta, first) = source.get(0..FIRST, None)?;
        (source.meta, source.first) = (meta, first);
        Ok(source)
    }

    /// The version that was opened.
    #[cfg_attr(not(feature = "convert"), allow(dead_code, reason = "only conversion reads what others may write"))]
    pub(super) fn stamp(&self) -> Stamp {
        let ObjectMeta { size, last_modified, e_tag, version, .. } = &self.meta;
        let hash = |bytes: &[u8]| xxhash_rust::xxh3::xxh3_64(bytes);
        let version = format!("{e_tag:?} {version:?}");
        let id = FileId::of_object(hash(self.name.as_bytes()), hash(version.as_bytes()));
        // A server that does not say gives the beginning of time.
        let modified = (last_modified.timestamp() > 0).then(|| (*last_modified).into());
        Stamp::of_object(*size, modified, id)
    }

    /// Whether all bytes before `end` came with the first request.
    pub(super) fn holds(&self, end: u64) -> bool {
        end <= self.first.len() as u64
    }

    /// The bytes of `range` that the object has, of the version `known`, or of any.
    fn get(&self, range: Range<u64>, known: Option<&ObjectMeta>) -> Result<(ObjectMeta, Vec<u8>)> {
        refuse_tasks(&self.name)?;
        let runtime = self.runtime.as_ref().expect("only dropping takes it");
        let (mut meta, mut bytes) = (known.cloned(), Vec::with_capacity((range.end - range.start) as usize));
        let mut failures = 0;
        loop {
            let failure = match runtime.block_on(self.ask(&range, &mut meta, &mut bytes)) {
                Ok(meta) => return Ok((meta, bytes)),
                Err(failure) => failure,
            };
            let wait = failure.wait(failures, self.options.timeout).filter(|_| failures < self.options.retries);
            let Some(wait) = wait else {
                let action = if known.is_none() { "open".to_owned() } else { reading(&range) };
                let error = io::Error::from(failure);
                return Err(Error::io(&self.name, action, if self.unsigned { said_unsigned(error) } else { error }));
            };
            failures += 1;
            std::thread::sleep(wait);
        }
    }

    /// One request for what `bytes` lacks of `range`; `meta` becomes known with the first answer.
    async fn ask(
        &self,
        range: &Range<u64>,
        meta: &mut Option<ObjectMeta>,
        bytes: &mut Vec<u8>,
    ) -> Result<ObjectMeta, Failure> {
        let mut options = meta.as_ref().map_or(GetOptions::default(), same_version);
        // A read that broke off is taken up where it did if that version can be asked for; else it begins again.
        if options.if_match.is_none() && options.if_unmodified_since.is_none() {
            bytes.clear();
        }
        let start = range.start + bytes.len() as u64;
        options.range = Some(GetRange::Bounded(start..range.end));
        let answer = self.store.get_opts(&self.path, options).await?;
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
            // More than was asked for is not kept.
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
}

impl Drop for RemoteSource {
    fn drop(&mut self) {
        // An ordinary drop waits for the runtime's threads, which panics in an asynchronous task.
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

impl std::fmt::Debug for RemoteSource {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RemoteSource").field("name", &self.name).field("meta", &self.meta).finish_non_exhaustive()
    }
}

/// Why a read failed.
enum Failure {
    Replaced,
    /// An answer that ended well, but too early.
    Short {
        missing: u64,
    },
    Store(object_store::Error),
}

impl Failure {
    /// How long to wait before the request is repeated, after so many failures; `None` if that is of no use.
    fn wait(&self, failures: usize, longest: Duration) -> Option<Duration> {
        let Self::Store(error) = self else { return None };
        let own = WAIT * (1 << failures.min(6));
        match cause::<Refusal>(error) {
            Some(refusal) if !refusal.may_pass() => None,
            Some(refusal) => {
                Some(refusal.wait.map_or(own, |asked| asked.max(own))).filter(|&wait| wait <= longest.max(own))
            }
            None => cause::<HttpError>(error).map(|_| own),
        }
    }
}

impl From<object_store::Error> for Failure {
    fn from(error: object_store::Error) -> Self {
        let replaced = matches!(error, object_store::Error::Precondition { .. })
            || cause::<Refusal>(&error).is_some_and(Refusal::is_replaced);
        if replaced { Self::Replaced } else { Self::Store(error) }
    }
}

/// As text alone: the errors of the store hold addresses.
impl From<Failure> for io::Error {
    fn from(failure: Failure) -> Self {
        let error = match failure {
            Failure::Replaced => {
                return Self::other("the object was replaced since it was opened; open it again");
            }
            Failure::Short { missing } => {
                return Self::new(io::ErrorKind::UnexpectedEof, format!("the answer lacks {missing} bytes"));
            }
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

/// Adds why a store may have refused a request that was not signed.
fn said_unsigned(error: io::Error) -> io::Error {
    match error.kind() {
        io::ErrorKind::PermissionDenied => {
            io::Error::new(error.kind(), format!("{error}; no credentials are set, so the request was not signed"))
        }
        _ => error,
    }
}

fn reading(range: &Range<u64>) -> String {
    format!("read {} bytes at {}", range.end - range.start, range.start)
}

/// Threads of an asynchronous runtime must not block.
fn refuse_tasks(name: &str) -> Result<()> {
    if Handle::try_current().is_err() {
        return Ok(());
    }
    let reason = "was asked for in an asynchronous task, which must not block; use a thread of your own";
    Err(Error::parameter(name, reason))
}

/// Asks for the version of `meta`, if the server can be asked that.
fn same_version(meta: &ObjectMeta) -> GetOptions {
    // A weak tag never matches; then the time of the last change has to do, if the server tells it.
    let strong = meta.e_tag.clone().filter(|tag| !tag.starts_with("W/"));
    let time = Some(meta.last_modified).filter(|time| strong.is_none() && time.timestamp() > 0);
    GetOptions { if_match: strong, if_unmodified_since: time, ..GetOptions::default() }
}

/// A store, and the path of an object in it.
struct Connected {
    store: Box<dyn ObjectStore>,
    path: Path,
    /// Without credentials in settings or environment: requests are not signed.
    unsigned: bool,
}

/// How a connection is used.
#[derive(Clone, Copy)]
struct Use {
    /// Repetitions by the store's client. For reading there are none: they are made here, where a server's wish to wait and the
    /// version are known.
    retries: usize,
    /// Uploads in parts are completed on the condition that no such object is there, where the store knows that condition.
    creates: bool,
}

impl Use {
    const READ: Self = Self { retries: 0, creates: false };
}

/// Connects to the store that serves `url`. Without credentials requests go unsigned: no machine's metadata address is asked
/// for them, unless the environment or a setting names it.
fn connect(mut url: Url, options: &RemoteOptions, how: Use) -> Result<Connected, String> {
    let client = ClientOptions::new().with_timeout(options.timeout).with_connect_timeout(options.timeout);
    let retry = RetryConfig { max_retries: how.retries, ..RetryConfig::default() };
    let web = matches!(url.scheme(), "http" | "https");
    let authorization = basic_authorization(&url);
    let secret = authorization.is_some() || url.query().is_some();
    if secret && !web {
        let what = if authorization.is_some() { "a user or password" } else { "a query" };
        return Err(format!(
            "has {what}, as only http and https addresses may; give the settings of the store instead"
        ));
    }
    match ObjectStoreScheme::parse(&url) {
        Ok((ObjectStoreScheme::AmazonS3, path)) if !secret => {
            connect_s3(&url, path, options, client, retry, how.creates)
        }
        #[cfg(feature = "clouds")]
        Ok((ObjectStoreScheme::GoogleCloudStorage, path)) if !secret => connect_gs(&url, path, options, client, retry),
        #[cfg(feature = "clouds")]
        Ok((ObjectStoreScheme::MicrosoftAzure, path)) if !secret && !web => {
            connect_az(&url, path, options, client, retry)
        }
        Ok((ObjectStoreScheme::Local, path)) => {
            Ok(Connected { store: Box::new(LocalFileSystem::new()), path, unsigned: false })
        }
        _ if web => {
            let client = client.with_allow_http(url.scheme() == "http");
            url.set_fragment(None);
            // The header says them.
            let _ = (url.set_username(""), url.set_password(None));
            // With the whole address as the base, and nothing below it, no character of its path is decoded.
            let server = HttpBuilder::new().with_url(url).with_client_options(client).with_retry(retry);
            let server = server.with_http_connector(Connector { authorization, creates: false });
            Ok(Connected { store: Box::new(server.build().map_err(text_of)?), path: Path::default(), unsigned: false })
        }
        #[cfg(not(feature = "clouds"))]
        Ok((ObjectStoreScheme::GoogleCloudStorage | ObjectStoreScheme::MicrosoftAzure, _)) => {
            Err("is of a store that this build does not know; build it with --features clouds".into())
        }
        _ => Err("is none that is supported; use https, http, s3, gs, az or file".into()),
    }
}

fn text_of(error: object_store::Error) -> String {
    one_line(&error.to_string())
}

/// Variables of the environment that begin with `prefix`, as names of settings.
fn environment(prefix: &'static str) -> impl Iterator<Item = (String, String)> {
    let text = |(name, value): (std::ffi::OsString, std::ffi::OsString)| {
        Some((name.to_str()?.to_owned(), value.to_str()?.to_owned()))
    };
    let named =
        move |(name, value): (String, String)| name.starts_with(prefix).then(|| (name.to_ascii_lowercase(), value));
    std::env::vars_os().filter_map(text).filter_map(named)
}

fn connect_s3(
    url: &Url,
    path: Path,
    options: &RemoteOptions,
    client: ClientOptions,
    retry: RetryConfig,
    creates: bool,
) -> Result<Connected, String> {
    use AmazonS3ConfigKey as Key;
    let mut builder = AmazonS3Builder::from_env().with_client_options(client).with_retry(retry).with_url(url.as_str());
    // Options of the client in the environment, such as AWS_ALLOW_HTTP, which those above replaced.
    for (name, value) in environment("AWS_") {
        if let Ok(key @ Key::Client(_)) = name.parse() {
            builder = builder.with_config(key, value);
        }
    }
    for (key, value) in &options.settings {
        builder = builder.with_config(key.to_ascii_lowercase().parse().map_err(text_of)?, value);
    }
    let given = |key: Key| builder.get_config_value(&key).is_some();
    let credentials = [
        Key::AccessKeyId,
        Key::SecretAccessKey,
        Key::WebIdentityTokenFile,
        Key::ContainerCredentialsRelativeUri,
        Key::ContainerCredentialsFullUri,
        Key::MetadataEndpoint,
    ];
    let unsigned = !credentials.into_iter().any(given);
    let conditional = builder.get_config_value(&Key::ConditionalPut).is_none_or(|value| value != "disabled");
    if unsigned {
        builder = builder.with_skip_signature(true);
    }
    let connector = Connector { authorization: None, creates: creates && conditional };
    let store = builder.with_http_connector(connector).build().map_err(text_of)?;
    Ok(Connected { store: Box::new(store), path, unsigned })
}

#[cfg(feature = "clouds")]
fn connect_gs(
    url: &Url,
    path: Path,
    options: &RemoteOptions,
    client: ClientOptions,
    retry: RetryConfig,
) -> Result<Connected, String> {
    use GoogleConfigKey as Key;
    let mut builder =
        GoogleCloudStorageBuilder::from_env().with_client_options(client).with_retry(retry).with_url(url.as_str());
    for (name, value) in environment("GOOGLE_") {
        if let Ok(key @ Key::Client(_)) = name.parse() {
            builder = builder.with_config(key, value);
        }
    }
    for (key, value) in &options.settings {
        builder = builder.with_config(key.to_ascii_lowercase().parse().map_err(text_of)?, value);
    }
    // Where the programs of that cloud leave the credentials of whoever logged in.
    let (home, below) = match cfg!(windows) {
        true => ("APPDATA", "gcloud/application_default_credentials.json"),
        false => ("HOME", ".config/gcloud/application_default_credentials.json"),
    };
    let logged_in = std::env::var_os(home).is_some_and(|home| std::path::Path::new(&home).join(below).is_file());
    let given = |key: Key| builder.get_config_value(&key).is_some();
    let credentials = [Key::ServiceAccount, Key::ServiceAccountKey, Key::ApplicationCredentials];
    let unsigned = !logged_in && !credentials.into_iter().any(given);
    if unsigned {
        builder = builder.with_skip_signature(true);
    }
    let connector = Connector { authorization: None, creates: false };
    let store = builder.with_http_connector(connector).build().map_err(text_of)?;
    Ok(Connected { store: Box::new(store), path, unsigned })
}

#[cfg(feature = "clouds")]
fn connect_az(
    url: &Url,
    path: Path,
    options: &RemoteOptions,
    client: ClientOptions,
    retry: RetryConfig,
) -> Result<Connected, String> {
    use AzureConfigKey as Key;
    let mut builder =
        MicrosoftAzureBuilder::from_env().with_client_options(client).with_retry(retry).with_url(url.as_str());
    for (name, value) in environment("AZURE_") {
        if let Ok(key @ Key::Client(_)) = name.parse() {
            builder = builder.with_config(key, value);
        }
    }
    for (key, value) in &options.settings {
        builder = builder.with_config(key.to_ascii_lowercase().parse().map_err(text_of)?, value);
    }
    let given = |key: Key| builder.get_config_value(&key).is_some();
    let credentials =
        [Key::AccessKey, Key::SasKey, Key::Token, Key::ClientSecret, Key::FederatedTokenFile, Key::MsiEndpoint];
    let is_set = |key: Key| builder.get_config_value(&key).is_some_and(|value| value == "true");
    let unsigned = !credentials.into_iter().any(given) && !is_set(Key::UseAzureCli) && !is_set(Key::UseEmulator);
    if unsigned {
        builder = builder.with_skip_signature(true);
    }
    let connector = Connector { authorization: None, creates: false };
    let store = builder.with_http_connector(connector).build().map_err(text_of)?;
    Ok(Connected { store: Box::new(store), path, unsigned })
}

/// The header for user and password of an address, if it has them.
fn basic_authorization(url: &Url) -> Option<HeaderValue> {
    if url.username().is_empty() && url.password().is_none() {
        return None;
    }
    let mut bytes: Vec<u8> = percent_decode_str(url.username()).collect();
    bytes.push(b':');
    bytes.extend(percent_decode_str(url.password().unwrap_or_default()));
    let text = format!("Basic {}", base64::engine::general_purpose::STANDARD.encode(bytes));
    let mut value = HeaderValue::try_from(text).ok()?;
    value.set_sensitive(true);
    Some(value)
}

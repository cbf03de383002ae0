//! State shared by the objects of one server or bucket: a client with its open connections, and the store with its
//! credentials.
//!
//! A thread of this module drives all connections until the process ends; callers that read or write wait on their own
//! threads. So the thousands of tiles of a scan need as many connections as there are concurrent requests, and
//! credentials from a service are requested once. Memory: that of [`MOST`] clients, and some tens of KiB per
//! connection; a connection idle for 90 s is closed.

use super::RemoteOptions;
use super::connect::Use;
use object_store::client::{HttpClient, HttpConnector, ReqwestConnector};
use object_store::{ClientOptions, ObjectStore, ObjectStoreScheme};
use std::mem::ManuallyDrop;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::runtime::{Builder, Handle};
use url::{Position, Url};

/// Most servers and buckets kept while no object of them is open.
const MOST: usize = 16;

static POOL: Mutex<Option<Pool>> = Mutex::new(None);

struct Pool {
    process: u32,
    runtime: Handle,
    /// The last one was used most recently.
    buckets: Vec<(Key, Arc<Bucket>)>,
}

/// Everything that a client and a store are built from. The environment holds addresses, credentials and proxies; a
/// program may change it.
#[derive(PartialEq)]
struct Key {
    place: String,
    options: RemoteOptions,
    environment: u128,
}

/// Store shared by objects.
#[derive(Clone)]
pub(super) struct Opened {
    pub store: Arc<dyn ObjectStore>,
    pub unsigned: bool,
}

/// State shared by the objects of one bucket.
pub(super) struct Bucket {
    pub runtime: Handle,
    pub process: u32,
    clients: Mutex<Vec<(String, HttpClient)>>,
    stores: Mutex<Vec<(Use, Opened)>>,
}

impl Bucket {
    /// Returns the store for this use, built on the first call.
    pub fn store(&self, how: Use, build: impl FnOnce() -> Result<Opened, String>) -> Result<Opened, String> {
        let mut stores = lock(&self.stores);
        if let Some((_, opened)) = stores.iter().find(|(known, _)| *known == how) {
            return Ok(opened.clone());
        }
        let opened = build()?;
        stores.push((how, opened.clone()));
        Ok(opened)
    }

    /// Returns the client with these options, built on the first call. Uploads, reads and requests for credentials
    /// share it.
    pub fn client(&self, options: &ClientOptions) -> object_store::Result<HttpClient> {
        let key = format!("{options:?}");
        let mut clients = lock(&self.clients);
        if let Some((_, client)) = clients.iter().find(|(known, _)| *known == key) {
            return Ok(client.clone());
        }
        let client = ReqwestConnector::default().connect(options)?;
        clients.push((key, client.clone()));
        Ok(client)
    }
}

/// Shows nothing, because stores, clients and keys may hold secrets.
impl std::fmt::Debug for Bucket {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Bucket").finish_non_exhaustive()
    }
}

/// Returns the state shared by the objects at the server or bucket of `url`; `Err` holds the reason if it is
/// unavailable.
pub(super) fn bucket(url: &Url, options: &RemoteOptions) -> Result<Arc<Bucket>, String> {
    let key = Key { place: place(url), options: options.clone(), environment: environment() };
    let mut pool = lock(&POOL);
    let process = std::process::id();
    if let Some(strange) = pool.take_if(|pool| pool.process != process) {
        // After a fork no thread drives these clients, and their locks may stay locked.
        let _ = ManuallyDrop::new(strange);
    }
    let pool = match &mut *pool {
        Some(pool) => pool,
        none => {
            let runtime =
                start().map_err(|error| format!("cannot be asked: no thread for its connections: {error}"))?;
            none.insert(Pool { process, runtime, buckets: Vec::new() })
        }
    };
    let known = pool.buckets.iter().position(|(known, _)| *known == key).map(|at| pool.buckets.remove(at).1);
    let bucket = known.unwrap_or_else(|| {
        let runtime = pool.runtime.clone();
        Arc::new(Bucket { runtime, process, clients: Mutex::default(), stores: Mutex::default() })
    });
    pool.buckets.push((key, bucket.clone()));
    if pool.buckets.len() > MOST {
        pool.buckets.remove(0);
    }
    Ok(bucket)
}

/// Starts the thread that drives connections.
fn start() -> std::io::Result<Handle> {
    let runtime = Builder::new_current_thread().enable_all().build()?;
    let handle = runtime.handle().clone();
    let drive = move || runtime.block_on(std::future::pending::<()>());
    std::thread::Builder::new().name("slicewalk-http".into()).spawn(drive)?;
    Ok(handle)
}

/// Returns the server, and the bucket if the path of a web address begins with it.
fn place(url: &Url) -> String {
    let server = format!("{}://{}", url.scheme(), &url[Position::BeforeHost..Position::AfterPort]);
    let segments = || url.path().split('/').filter(|segment| !segment.is_empty());
    match ObjectStoreScheme::parse(url) {
        Ok((_, path)) if path.parts().count() < segments().count() => {
            format!("{server}/{}", segments().next().unwrap_or_default())
        }
        _ => server,
    }
}

fn environment() -> u128 {
    let mut hash = xxhash_rust::xxh3::Xxh3Default::new();
    for (name, value) in std::env::vars_os() {
        for part in [name, value] {
            hash.update(part.as_encoded_bytes());
            hash.update(&[0]);
        }
    }
    hash.digest128()
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_share_what_their_place_options_and_environment_decide() {
        let options = RemoteOptions::default();
        let of = |address: &str, options: &RemoteOptions| bucket(&Url::parse(address).unwrap(), options).unwrap();
        let one = of("s3://one/a.laz", &options);
        assert!(Arc::ptr_eq(&one, &of("s3://one/deep/b.laz", &options)));
        assert!(!Arc::ptr_eq(&one, &of("s3://two/a.laz", &options)));
        assert!(!Arc::ptr_eq(&one, &of("gs://one/a.laz", &options)));
        let settings = vec![("aws_region".to_owned(), "here".to_owned())];
        assert!(!Arc::ptr_eq(&one, &of("s3://one/a.laz", &RemoteOptions { settings, ..options.clone() })));
        let server = of("http://host:81/a.laz", &options);
        assert!(Arc::ptr_eq(&server, &of("http://host:81/deep/b.laz?key=1", &options)));
        assert!(!Arc::ptr_eq(&server, &of("http://host:82/a.laz", &options)));
        // Paths of object stores may begin with the bucket.
        let bucket = of("https://s3.eu-west-1.amazonaws.com/one/a.laz", &options);
        assert!(!Arc::ptr_eq(&bucket, &of("https://s3.eu-west-1.amazonaws.com/two/a.laz", &options)));
        let bucket = of("https://one.s3.eu-west-1.amazonaws.com/a.laz", &options);
        assert!(Arc::ptr_eq(&bucket, &of("https://one.s3.eu-west-1.amazonaws.com/deep/b.laz", &options)));
        // The oldest are dropped.
        (0..MOST).for_each(|number| drop(of(&format!("s3://many{number}/a"), &options)));
        assert!(!Arc::ptr_eq(&one, &of("s3://one/a.laz", &options)));
    }
}

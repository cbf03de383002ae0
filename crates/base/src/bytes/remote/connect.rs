//! Connection of an address to the store that serves it. Sends nothing yet.

use super::RemoteOptions;
use super::pool::{Bucket, Opened, bucket};
use super::text::one_line;
use super::transport::Connector;
use base64::Engine;
use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
#[cfg(feature = "clouds")]
use object_store::azure::{AzureConfigKey, MicrosoftAzureBuilder};
#[cfg(feature = "clouds")]
use object_store::gcp::{GoogleCloudStorageBuilder, GoogleConfigKey};
use object_store::http::HttpBuilder;
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{ClientOptions, HeaderValue, ObjectStore, ObjectStoreScheme, RetryConfig};
use percent_encoding::percent_decode_str;
use std::future::Future;
use std::io;
use std::sync::Arc;
use tokio::runtime::Handle;
use url::Url;

/// Store, and the path of an object in it.
pub(super) struct Connected {
    pub store: Arc<dyn ObjectStore>,
    pub path: Path,
    /// True without credentials in settings or environment: requests are not signed.
    unsigned: bool,
    runtime: Handle,
    /// Process whose thread drives the connections.
    process: u32,
}

impl Connected {
    /// Waits for the result of `work` on this store; blocks the calling thread.
    pub fn wait_for<T>(&self, work: impl Future<Output = T>) -> io::Result<T> {
        if self.process != std::process::id() {
            return Err(io::Error::other("it was opened before a fork, in another process; open it again"));
        }
        Ok(self.runtime.block_on(work))
    }

    /// Adds to `error` the reason why the store may have refused an unsigned request.
    pub fn explained(&self, error: io::Error) -> io::Error {
        match error.kind() {
            io::ErrorKind::PermissionDenied if self.unsigned => {
                io::Error::new(error.kind(), format!("{error}; no credentials are set, so the request was not signed"))
            }
            _ => error,
        }
    }
}

/// Use of a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Use {
    /// Retries by the store's client. Reads have none: this module retries them, because it knows the version and the
    /// wait that the server asks for.
    pub retries: usize,
    /// True if an upload in parts is completed only if the object does not exist, where the store supports that
    /// condition.
    pub creates: bool,
    /// True if the client ends requests that take longer than the time-out. Reads watch the time themselves.
    pub timed: bool,
}

impl Use {
    pub const READ: Self = Self { retries: 0, creates: false, timed: false };
    pub const LIST: Self = Self { timed: true, ..Self::READ };
}

/// Input of the builder of a store.
struct Wanted<'a> {
    url: &'a Url,
    options: &'a RemoteOptions,
    how: Use,
    client: ClientOptions,
    retry: RetryConfig,
    bucket: &'a Arc<Bucket>,
}

/// Connects to the store that serves `url`. Without credentials, requests are not signed: no metadata service of the
/// machine is asked for them, unless the environment or a setting names it.
pub(super) fn connect(mut url: Url, options: &RemoteOptions, how: Use) -> Result<Connected, String> {
    let client = ClientOptions::new().with_connect_timeout(options.timeout);
    let client = if how.timed { client.with_timeout(options.timeout) } else { client.with_timeout_disabled() };
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
    let bucket = bucket(&url, options)?;
    let build = |build: fn(Wanted<'_>) -> Result<Opened, String>| {
        bucket.store(how, || {
            build(Wanted { url: &url, options, how, client: client.clone(), retry: retry.clone(), bucket: &bucket })
        })
    };
    let (Opened { store, unsigned }, path) = match ObjectStoreScheme::parse(&url) {
        Ok((ObjectStoreScheme::AmazonS3, path)) if !secret => (build(s3)?, path),
        #[cfg(feature = "clouds")]
        Ok((ObjectStoreScheme::GoogleCloudStorage, path)) if !secret => (build(gs)?, path),
        #[cfg(feature = "clouds")]
        Ok((ObjectStoreScheme::MicrosoftAzure, path)) if !secret && !web => (build(az)?, path),
        Ok((ObjectStoreScheme::Local, path)) => {
            (Opened { store: Arc::new(LocalFileSystem::new()), unsigned: false }, path)
        }
        _ if web => {
            let client = client.with_allow_http(url.scheme() == "http");
            url.set_fragment(None);
            // The header holds them.
            let _ = (url.set_username(""), url.set_password(None));
            // With the whole address as the base and an empty path below it, no character of its path is decoded.
            let server = HttpBuilder::new().with_url(url).with_client_options(client).with_retry(retry);
            let server =
                server.with_http_connector(Connector { bucket: bucket.clone(), authorization, creates: false });
            (Opened { store: Arc::new(server.build().map_err(text_of)?), unsigned: false }, Path::default())
        }
        #[cfg(not(feature = "clouds"))]
        Ok((ObjectStoreScheme::GoogleCloudStorage | ObjectStoreScheme::MicrosoftAzure, _)) => {
            return Err("is of a store that this build does not know; build it with --features clouds".into());
        }
        _ => return Err("has an unsupported scheme; use https, http, s3, gs, az or file".into()),
    };
    Ok(Connected { store, path, unsigned, runtime: bucket.runtime.clone(), process: bucket.process })
}

fn text_of(error: object_store::Error) -> String {
    one_line(&error.to_string())
}

/// Returns the variables of the environment that begin with `prefix`, as names of settings.
fn environment(prefix: &'static str) -> impl Iterator<Item = (String, String)> {
    let text = |(name, value): (std::ffi::OsString, std::ffi::OsString)| {
        Some((name.to_str()?.to_owned(), value.to_str()?.to_owned()))
    };
    let named =
        move |(name, value): (String, String)| name.starts_with(prefix).then(|| (name.to_ascii_lowercase(), value));
    std::env::vars_os().filter_map(text).filter_map(named)
}

/// Builds a store from the environment and the settings in `$wanted`. `$value` looks up a setting for the two
/// expressions: `$signs`, whether there are credentials to sign requests with, and `$creates`, whether the last request
/// of an upload in parts supports the condition of [`Use::creates`]. The builders of the stores have the same methods,
/// but no common trait.
macro_rules! built {
    ($builder:ident, $key:ident, $prefix:literal, $wanted:expr, |$value:ident| signs: $signs:expr, creates: $creates:expr) => {{
        let Wanted { url, options, how, client, retry, bucket } = $wanted;
        let mut builder = $builder::from_env().with_client_options(client).with_retry(retry).with_url(url.as_str());
        // Options of the client in the environment, such as AWS_ALLOW_HTTP, which `with_client_options` replaced.
        for (name, value) in environment($prefix) {
            if let Ok(key @ $key::Client(_)) = name.parse() {
                builder = builder.with_config(key, value);
            }
        }
        for (key, value) in &options.settings {
            builder = builder.with_config(key.to_ascii_lowercase().parse().map_err(text_of)?, value);
        }
        let $value = |key: $key| builder.get_config_value(&key);
        let (unsigned, creates) = (!$signs, how.creates && $creates);
        if unsigned {
            builder = builder.with_skip_signature(true);
        }
        let connector = Connector { bucket: bucket.clone(), authorization: None, creates };
        let store = builder.with_http_connector(connector).build().map_err(text_of)?;
        Ok(Opened { store: Arc::new(store), unsigned })
    }};
}

fn s3(wanted: Wanted<'_>) -> Result<Opened, String> {
    use AmazonS3ConfigKey as Key;
    let credentials = [
        Key::AccessKeyId,
        Key::SecretAccessKey,
        Key::WebIdentityTokenFile,
        Key::ContainerCredentialsRelativeUri,
        Key::ContainerCredentialsFullUri,
        Key::MetadataEndpoint,
    ];
    built!(AmazonS3Builder, AmazonS3ConfigKey, "AWS_", wanted, |value|
        signs: credentials.into_iter().any(|key| value(key).is_some()),
        creates: value(Key::ConditionalPut).is_none_or(|value| value != "disabled"))
}

#[cfg(feature = "clouds")]
fn gs(wanted: Wanted<'_>) -> Result<Opened, String> {
    use GoogleConfigKey as Key;
    // Path where the programs of that cloud store the credentials of the user who logged in.
    let (home, below) = match cfg!(windows) {
        true => ("APPDATA", "gcloud/application_default_credentials.json"),
        false => ("HOME", ".config/gcloud/application_default_credentials.json"),
    };
    let logged_in = std::env::var_os(home).is_some_and(|home| std::path::Path::new(&home).join(below).is_file());
    let credentials = [Key::ServiceAccount, Key::ServiceAccountKey, Key::ApplicationCredentials];
    built!(GoogleCloudStorageBuilder, GoogleConfigKey, "GOOGLE_", wanted, |value|
        signs: logged_in || credentials.into_iter().any(|key| value(key).is_some()),
        creates: false)
}

#[cfg(feature = "clouds")]
fn az(wanted: Wanted<'_>) -> Result<Opened, String> {
    use AzureConfigKey as Key;
    let credentials =
        [Key::AccessKey, Key::SasKey, Key::Token, Key::ClientSecret, Key::FederatedTokenFile, Key::MsiEndpoint];
    let switches = [Key::UseAzureCli, Key::UseEmulator];
    built!(MicrosoftAzureBuilder, AzureConfigKey, "AZURE_", wanted, |value|
        signs: credentials.into_iter().any(|key| value(key).is_some())
            || switches.into_iter().any(|key| value(key).is_some_and(|value| value == "true")),
        creates: false)
}

/// Returns the header for user and password of an address, if it has them.
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

#[cfg(test)]
mod tests {
    use super::*;

    fn open(address: &str, settings: &[(&str, &str)]) -> Result<Connected, String> {
        let settings = settings.iter().map(|(key, value)| (key.to_string(), value.to_string())).collect();
        let options = RemoteOptions { settings, ..RemoteOptions::default() };
        connect(Url::parse(address).unwrap(), &options, Use::READ)
    }

    #[test]
    fn users_and_queries_are_for_web_servers_only() {
        for (address, words) in [
            ("s3://anna@bucket/a.laz", "a user or password"),
            ("gs://bucket/a.laz?key=1", "a query"),
            ("file:///a.laz?key=1", "a query"),
        ] {
            let said = open(address, &[]).err().unwrap();
            assert!(said.contains(words) && !said.contains("anna"), "{said}");
        }
    }

    #[cfg(feature = "clouds")]
    #[test]
    fn addresses_of_clouds_name_objects_and_requests_are_signed_with_a_key_only() {
        let (account, key) = (("azure_storage_account_name", "anyone"), ("AZURE_STORAGE_ACCOUNT_KEY", "aHVzaCBodXNo"));
        for (settings, unsigned) in [(&[account][..], true), (&[account, key][..], false)] {
            let store = open("az://container/a/b.laz", settings).unwrap_or_else(|said| panic!("{said}"));
            assert_eq!((store.path.as_ref(), store.unsigned), ("a/b.laz", unsigned));
        }
        let store = open("gs://bucket/a/b.laz", &[]).unwrap_or_else(|said| panic!("{said}"));
        assert_eq!(store.path.as_ref(), "a/b.laz");
        let said = open("gs://bucket/a/b.laz", &[("aws_region", "here")]).err().unwrap();
        assert!(said.contains("aws_region"), "{said}");
    }
}

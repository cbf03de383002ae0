//! HTTP client below `object_store`. It limits what it reads from a server that refuses, and keeps what the store would
//! lose: the status, the server's reason, and the wait it asks for.

use super::pool::Bucket;
use super::text::one_line;
use async_trait::async_trait;
use chrono::DateTime;
use futures_util::StreamExt;
use object_store::ClientOptions;
use object_store::HeaderValue;
use object_store::client::{
    HttpClient, HttpConnector, HttpError, HttpErrorKind, HttpRequest, HttpResponse, HttpResponseBody, HttpService,
};
use std::sync::Arc;
use std::time::Duration;

/// Most bytes read of a refusal's body.
const SAID: usize = 1 << 10;

const NOT_FOUND: u16 = 404;
const TIMED_OUT: u16 = 408;
const GONE: u16 = 410;
const REPLACED: u16 = 412;
const OUTSIDE: u16 = 416;
const TOO_MANY: u16 = 429;
const PARTIAL: u16 = 206;

/// Answer other than the requested bytes.
#[derive(Debug, Clone)]
pub(super) struct Refusal {
    status: u16,
    /// Number and name of the status.
    name: String,
    /// Wait that the server asks for.
    pub(super) wait: Option<Duration>,
    /// Beginning of the body, as one line.
    said: String,
}

impl std::fmt::Display for Refusal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "HTTP status {}", self.name)?;
        if let Some(wait) = self.wait {
            write!(f, ", retry after {} s", wait.as_secs())?;
        }
        if self.said.is_empty() { Ok(()) } else { write!(f, ": {}", self.said) }
    }
}

impl std::error::Error for Refusal {}

impl Refusal {
    /// Returns whether the requested version is gone.
    pub(super) fn is_replaced(&self) -> bool {
        self.status == REPLACED
    }

    /// Returns whether the same request may succeed later.
    pub(super) fn may_pass(&self) -> bool {
        matches!(self.status, TIMED_OUT | TOO_MANY | 500..=599)
    }

    /// Returns the nearest kind of error.
    pub(super) fn kind(&self) -> std::io::ErrorKind {
        match self.status {
            401 | 403 => std::io::ErrorKind::PermissionDenied,
            NOT_FOUND | GONE => std::io::ErrorKind::NotFound,
            _ => std::io::ErrorKind::Other,
        }
    }
}

/// Builder of the HTTP client of a store, on the connections that all objects of a bucket share.
#[derive(Debug)]
pub(super) struct Connector {
    pub(super) bucket: Arc<Bucket>,
    /// Header sent with every request.
    pub(super) authorization: Option<HeaderValue>,
    /// True if uploads in parts are completed only if the object does not exist (`If-None-Match` of S3, which the
    /// signature need not cover).
    pub(super) creates: bool,
}

impl HttpConnector for Connector {
    fn connect(&self, options: &ClientOptions) -> object_store::Result<HttpClient> {
        // Fails if the program has chosen its own provider, which then stays.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let client = self.bucket.client(options)?;
        Ok(HttpClient::new(Transport { client, authorization: self.authorization.clone(), creates: self.creates }))
    }
}

#[derive(Debug)]
struct Transport {
    client: HttpClient,
    authorization: Option<HeaderValue>,
    creates: bool,
}

#[async_trait]
impl HttpService for Transport {
    async fn call(&self, mut request: HttpRequest) -> Result<HttpResponse, HttpError> {
        if let Some(value) = &self.authorization {
            request.headers_mut().insert("authorization", value.clone());
        }
        let completes = request.method().as_str() == "POST"
            && request.uri().query().is_some_and(|query| query.split('&').any(|pair| pair.starts_with("uploadId=")));
        if self.creates && completes {
            request.headers_mut().insert("if-none-match", HeaderValue::from_static("*"));
        }
        // Other requests are the store's own, for credentials and uploads; the store checks their answers.
        let range = request.headers().get("range").cloned();
        let reads = range.is_some();
        let lists = request.method().as_str() == "GET"
            && request.uri().query().is_some_and(|query| query.contains("list-type=2") || query.contains("comp=list"));
        let answer = self.client.execute(request).await?;
        let status = answer.status();
        if status.is_success() && (!reads || status.as_u16() == PARTIAL) {
            return Ok(mended(answer));
        }
        let (parts, body) = answer.into_parts();
        let body = beginning(body).await;
        if !reads && !lists {
            return Ok(HttpResponse::from_parts(parts, body.into()));
        }
        let seconds = parts.headers.get("retry-after").and_then(|value| value.to_str().ok()?.trim().parse().ok());
        let from_start = range.is_some_and(|range| range.as_bytes().starts_with(b"bytes=0-"));
        let said = match status.is_success() {
            true => "the server does not serve byte ranges".to_string(),
            false if status.as_u16() == OUTSIDE && from_start => "the object is empty".to_string(),
            false => one_line(&String::from_utf8_lossy(&body)),
        };
        let wait = seconds.map(Duration::from_secs);
        let refusal = Refusal { status: status.as_u16(), name: status.to_string(), wait, said };
        Err(HttpError::new(HttpErrorKind::Unknown, refusal))
    }
}

/// Reads the beginning of a body, as far as it arrives.
async fn beginning(body: HttpResponseBody) -> Vec<u8> {
    let (mut start, mut stream) = (Vec::new(), body.bytes_stream());
    while let Some(Ok(part)) = stream.next().await {
        start.extend_from_slice(&part[..part.len().min(SAID - start.len())]);
        if start.len() == SAID {
            break;
        }
    }
    start
}

/// Removes headers that the store would fail to read though nothing depends on them: names of files in another encoding
/// than ASCII, for example, and dates in another form. Adds the length that it requires, from `Content-Range`, to answers
/// sent in chunks, which state none.
fn mended(mut answer: HttpResponse) -> HttpResponse {
    let headers = answer.headers_mut();
    let is_odd = |name: &str, value: &HeaderValue| match (name, value.to_str()) {
        // The version and the bytes must be understood.
        ("etag" | "content-range" | "content-length", _) => false,
        ("last-modified", Ok(date)) => DateTime::parse_from_rfc2822(date).is_err(),
        (_, text) => text.is_err(),
    };
    let odd: Vec<_> =
        headers.iter().filter(|(name, value)| is_odd(name.as_str(), value)).map(|(name, _)| name.clone()).collect();
    odd.iter().for_each(|name| drop(headers.remove(name)));
    let range = headers.get("content-range").and_then(|value| value.to_str().ok());
    if let Some(length) = range.and_then(length_of)
        && !headers.contains_key("content-length")
    {
        headers.insert("content-length", length.into());
    }
    answer
}

/// Returns the number of bytes in `bytes FIRST-LAST/SIZE`.
fn length_of(range: &str) -> Option<u64> {
    let (first, last) = range.trim().strip_prefix("bytes ")?.split_once('/')?.0.split_once('-')?;
    last.parse::<u64>().ok()?.checked_sub(first.parse().ok()?)?.checked_add(1)
}

#[cfg(test)]
mod tests {
    use super::length_of;

    #[test]
    fn lengths_of_ranges() {
        assert_eq!(length_of("bytes 5-9/20"), Some(5));
        assert_eq!(length_of("bytes 0-0/*"), Some(1));
        let senseless =
            ["", "bytes */20", "bytes 9-5/20", "bytes 0-18446744073709551615/1", "lines 0-1/2", "bytes a-b/c"];
        assert!(senseless.iter().all(|range| length_of(range).is_none()));
    }
}

//! Upload of an object: whole or not at all.

use super::{Connected, Use, connect, one_line, public_name, refuse_tasks};
use crate::bytes::named::patient;
use crate::{Error, Parameter, Result};
use futures_util::StreamExt;
use futures_util::stream::FuturesUnordered;
use object_store::path::Path;
use object_store::{MultipartUpload, ObjectStore, ObjectStoreExt, ObjectStoreScheme, PutMode, PutPayload};
use std::io;
use std::path::Path as FilePath;
use std::time::Duration;
use url::Url;

/// Length of a part of an upload (bytes), unless there would be too many parts.
const PART: u64 = 5 << 20;
/// Most parts; stores allow 10,000.
const MOST_PARTS: u64 = 9000;
/// Bytes of the parts in flight at the same time, unless one part is longer.
const ON_THEIR_WAY: u64 = 4 * PART;

/// An upload is not retried once the wait before the retry reaches this.
const LONGEST_WAIT: Duration = Duration::from_secs(5);
/// How long to wait for the other parts in flight after a part has failed.
const LATE: Duration = Duration::from_secs(20);

/// Reason why an upload failed.
enum Failed {
    Store(object_store::Error),
    Local(Error),
    Exists,
    Other(String),
}

impl From<object_store::Error> for Failed {
    fn from(error: object_store::Error) -> Self {
        match error {
            object_store::Error::AlreadyExists { .. } | object_store::Error::Precondition { .. } => Self::Exists,
            error => Self::Store(error),
        }
    }
}

/// Returns whether the same upload may succeed later.
fn may_pass(error: &object_store::Error) -> bool {
    matches!(error, object_store::Error::Generic { .. } | object_store::Error::NotFound { .. })
}

/// Fails with the reason if no object can be written at `address`.
pub fn check_upload(address: &FilePath) -> Result<()> {
    checked(address).map(drop)
}

fn checked(address: &FilePath) -> Result<Url> {
    let refused = |reason: String| Error::parameter("address of an output", reason);
    let url = Url::parse(&address.to_string_lossy()).map_err(|error| refused(error.to_string()))?;
    match ObjectStoreScheme::parse(&url) {
        Ok((
            ObjectStoreScheme::AmazonS3 | ObjectStoreScheme::GoogleCloudStorage | ObjectStoreScheme::MicrosoftAzure,
            path,
        )) if url.query().is_none() && !path.as_ref().is_empty() && !matches!(url.scheme(), "http" | "https") => {
            Ok(url)
        }
        _ => {
            let reason = "only files and s3://, gs:// and az:// addresses with a name can be written";
            Err(refused(format!("{}: {reason}", public_name(&url))))
        }
    }
}

/// Writes `len` bytes from `read` to the object at `address`, in one request, or in parts that the last request joins,
/// so that the object appears whole or not at all. Retries failed requests for some minutes. If `create` is true, an
/// existing object stays: the last request carries that condition where the store supports it, and an upload in parts
/// checks directly before.
///
/// Memory: 20 MiB for four parts in flight. Beyond 44 GiB parts are longer, and beyond 176 GiB the memory is that of
/// one part, a 9000th of the whole. If a part fails, the store is asked to discard the others. Leftovers of a killed
/// upload are invisible; a rule of the bucket removes them.
pub fn upload(
    address: &FilePath,
    len: u64,
    create: bool,
    read: &mut dyn FnMut(u64, &mut [u8]) -> Result<()>,
) -> Result<()> {
    let refused = |reason: String| Error::parameter("address of an output", reason);
    let url = checked(address)?;
    let name = public_name(&url);
    refuse_tasks(&name)?;
    let connected = connect(url, &patient(), Use { retries: 8, creates: create, timed: true }).map_err(refused)?;
    let Connected { store, path, .. } = &connected;
    let mut wait = Duration::from_millis(100);
    let mut together = ON_THEIR_WAY;
    let done = loop {
        let sent = connected.wait_for(put(&**store, path, len, create, together, read));
        match sent.map_err(|error| Error::io(&name, "write", error))? {
            // The store's client does not retry a request that may have succeeded before its answer was lost.
            Err(Failed::Store(error)) if wait < LONGEST_WAIT && may_pass(&error) => {
                std::thread::sleep(wait);
                wait *= 4;
                // The connection may be too slow for several parts.
                together = PART;
            }
            done => break done,
        }
    };
    done.map_err(|failed| match failed {
        Failed::Local(error) => error,
        Failed::Exists => Error::output(&name, "exists already").with_suggestion(Parameter::Overwrite),
        Failed::Store(error) => {
            use object_store::Error::{PermissionDenied, Unauthenticated};
            let denied = matches!(error, PermissionDenied { .. } | Unauthenticated { .. });
            let kind = if denied { io::ErrorKind::PermissionDenied } else { io::ErrorKind::Other };
            let error = io::Error::new(kind, one_line(&error.to_string()));
            Error::io(&name, "write", connected.explained(error))
        }
        Failed::Other(reason) => Error::io(&name, "write", io::Error::other(reason)),
    })
}

async fn put(
    store: &dyn ObjectStore,
    path: &Path,
    len: u64,
    create: bool,
    together: u64,
    read: &mut dyn FnMut(u64, &mut [u8]) -> Result<()>,
) -> Result<(), Failed> {
    let part = PART.max(len.div_ceil(MOST_PARTS));
    let mut bytes_at = |at: u64| -> Result<PutPayload, Failed> {
        let mut bytes = vec![0; (len - at).min(part) as usize];
        read(at, &mut bytes).map_err(Failed::Local)?;
        Ok(bytes.into())
    };
    if len <= part {
        let payload = bytes_at(0)?;
        let mode = if create { PutMode::Create } else { PutMode::Overwrite };
        match store.put_opts(path, payload.clone(), mode.into()).await {
            // The store does not support the condition, or the environment switched it off.
            Err(object_store::Error::NotImplemented { .. }) if create => {
                refuse_existing(store, path).await?;
                store.put_opts(path, payload, PutMode::Overwrite.into()).await?;
            }
            done => drop(done?),
        }
    } else {
        let mut upload = store.put_multipart(path).await?;
        let starts = (0..len).step_by(part as usize);
        let mut sent = send(&mut *upload, starts, together / part, &mut bytes_at).await;
        if sent.is_ok() && create {
            sent = refuse_existing(store, path).await;
        }
        if sent.is_ok() {
            sent = upload.complete().await.map(drop).map_err(Failed::from);
        }
        if let Err(failed) = sent {
            // If that fails too, the parts stay invisible.
            let _ = upload.abort().await;
            return Err(failed);
        }
    }
    match store.head(path).await? {
        found if found.size == len => Ok(()),
        found => {
            Err(Failed::Other(format!("the store says that it has {} bytes of {len}; write it again", found.size)))
        }
    }
}

/// Sends the parts that begin at `starts`, at most `together` (at least one) at a time. No part is in flight when this
/// returns: a part that arrived after the upload was discarded would stay.
async fn send(
    upload: &mut dyn MultipartUpload,
    mut starts: impl Iterator<Item = u64>,
    together: u64,
    bytes_at: &mut dyn FnMut(u64) -> Result<PutPayload, Failed>,
) -> Result<(), Failed> {
    let mut on_their_way = FuturesUnordered::new();
    let failed = loop {
        if (on_their_way.len() as u64) < together.max(1)
            && let Some(at) = starts.next()
        {
            match bytes_at(at) {
                Ok(bytes) => on_their_way.push(upload.put_part(bytes)),
                Err(failed) => break failed,
            }
            continue;
        }
        match on_their_way.next().await {
            None => return Ok(()),
            Some(Ok(())) => {}
            Some(Err(error)) => break error.into(),
        }
    };
    let _ = tokio::time::timeout(LATE, on_their_way.for_each(|_| std::future::ready(()))).await;
    Err(failed)
}

async fn refuse_existing(store: &dyn ObjectStore, path: &Path) -> Result<(), Failed> {
    match store.head(path).await {
        Ok(_) => Err(Failed::Exists),
        Err(object_store::Error::NotFound { .. }) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_objects_of_stores_are_written() {
        for address in ["s3://bucket/a.slices", "gs://bucket/a b.slices", "az://container/a"] {
            check_upload(FilePath::new(address)).unwrap();
        }
        for address in [
            "",
            "s3://[/a",
            "s3://bucket",
            "s3://bucket/a?key=1",
            "http://host/a",
            "https://bucket.s3.amazonaws.com/a",
            "file:///a",
        ] {
            let said = check_upload(FilePath::new(address)).unwrap_err().to_string();
            assert!(said.starts_with("address of an output: "), "{said}");
        }
        let said = upload(FilePath::new("s3://anna@bucket/a"), 3, false, &mut |_, _| Ok(())).unwrap_err().to_string();
        assert!(said.contains("a user or password") && !said.contains("anna"), "{said}");
    }
}

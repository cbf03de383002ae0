//! Writing an object: whole or not at all.

use super::{Connected, Use, connect, one_line, public_name, refuse_tasks, said_unsigned};
use crate::bytes::named::patient;
use crate::{Error, Parameter, Result};
use object_store::path::Path;
use object_store::{MultipartUpload, ObjectStore, ObjectStoreExt, ObjectStoreScheme, PutMode, PutPayload};
use std::io;
use tokio::runtime::Builder;
use url::Url;

/// Bytes of a part of an upload, unless there would be too many parts.
const PART: u64 = 5 << 20;
/// Most parts; stores allow 10,000.
const MOST_PARTS: u64 = 9000;

/// No upload is tried again after that wait.
const LONGEST_WAIT: std::time::Duration = std::time::Duration::from_secs(5);

/// What an upload failed by.
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

/// Whether the same upload may succeed later.
fn may_pass(error: &object_store::Error) -> bool {
    matches!(error, object_store::Error::Generic { .. } | object_store::Error::NotFound { .. })
}

/// Whether objects can be written at `address`; `Err` says why not.
pub(crate) fn check_upload(address: &str) -> Result<()> {
    let refused = |reason: String| Error::parameter("address of an output", reason);
    let url = Url::parse(address).map_err(|error| refused(error.to_string()))?;
    match ObjectStoreScheme::parse(&url) {
        Ok((
            ObjectStoreScheme::AmazonS3 | ObjectStoreScheme::GoogleCloudStorage | ObjectStoreScheme::MicrosoftAzure,
            path,
        )) if url.query().is_none() && !path.as_ref().is_empty() && !matches!(url.scheme(), "http" | "https") => Ok(()),
        _ => {
            let reason = "only files and s3://, gs:// and az:// addresses with a name can be written";
            Err(refused(format!("{}: {reason}", public_name(&url))))
        }
    }
}

/// Writes the `len` bytes that `read` gives to the object at `address`: in one request, or in parts that the last request
/// joins, so that the object is there whole or not at all. Failed requests are repeated for some minutes. If `create`,
/// an object that is there stays: the last request has that condition, where the store knows it, and a look comes just before it.
///
/// Memory: one part, 5 MiB up to 44 GiB. What a killed upload leaves is invisible; a rule of the bucket removes it.
pub(crate) fn upload(
    address: &str,
    len: u64,
    create: bool,
    read: &mut dyn FnMut(u64, &mut [u8]) -> Result<()>,
) -> Result<()> {
    check_upload(address)?;
    let refused = |reason: String| Error::parameter("address of an output", reason);
    let url = Url::parse(address).map_err(|error| refused(error.to_string()))?;
    let name = public_name(&url);
    refuse_tasks(&name)?;
    let Connected { store, path, unsigned } =
        connect(url, &patient(), Use { retries: 8, creates: create }).map_err(refused)?;
    let runtime = Builder::new_current_thread().enable_all().build();
    let runtime = runtime.map_err(|error| Error::io(&name, "start its runtime", error))?;
    let mut wait = std::time::Duration::from_millis(100);
    let done = loop {
        match runtime.block_on(put(&*store, &path, len, create, read)) {
            // The store's client repeats no request that could have been done before its answer was lost.
            Err(Failed::Store(error)) if wait < LONGEST_WAIT && may_pass(&error) => {
                std::thread::sleep(wait);
                wait *= 4;
            }
            done => break done,
        }
    };
    done.map_err(|failed| match failed {
        Failed::Local(error) => error,
        Failed::Exists => Error::output(&name, "exists already").with_way_out(Parameter::Overwrite),
        Failed::Store(error) => {
            use object_store::Error::{PermissionDenied, Unauthenticated};
            let denied = matches!(error, PermissionDenied { .. } | Unauthenticated { .. });
            let kind = if denied { io::ErrorKind::PermissionDenied } else { io::ErrorKind::Other };
            let error = io::Error::new(kind, one_line(&error.to_string()));
            Error::io(&name, "write", if unsigned { said_unsigned(error) } else { error })
        }
        Failed::Other(reason) => Error::io(&name, "write", io::Error::other(reason)),
    })
}

async fn put(
    store: &dyn ObjectStore,
    path: &Path,
    len: u64,
    create: bool,
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
            // The store does not know the condition, or the environment switched it off.
            Err(object_store::Error::NotImplemented { .. }) if create => {
                refuse_existing(store, path).await?;
                store.put_opts(path, payload, PutMode::Overwrite.into()).await?;
            }
            done => drop(done?),
        }
    } else {
        let mut upload = store.put_multipart(path).await?;
        let sent = send(store, path, len, part, create, &mut *upload, &mut bytes_at).await;
        if let Err(failed) = sent {
            // If that fails too, its parts stay invisible.
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

async fn send(
    store: &dyn ObjectStore,
    path: &Path,
    len: u64,
    part: u64,
    create: bool,
    upload: &mut dyn MultipartUpload,
    bytes_at: &mut dyn FnMut(u64) -> Result<PutPayload, Failed>,
) -> Result<(), Failed> {
    for at in (0..len).step_by(part as usize) {
        upload.put_part(bytes_at(at)?).await?;
    }
    if create {
        refuse_existing(store, path).await?;
    }
    upload.complete().await?;
    Ok(())
}

async fn refuse_existing(store: &dyn ObjectStore, path: &Path) -> Result<(), Failed> {
    match store.head(path).await {
        Ok(_) => Err(Failed::Exists),
        Err(object_store::Error::NotFound { .. }) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

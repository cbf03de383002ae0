//! Listing of the objects of a store below a prefix.

use super::{Failure, Refusal, Use, WAIT, cause, connect, public_name, refuse_tasks, sleep, unless_stopped};
use crate::bytes::named::patient;
use crate::{Error, Result};
use futures_util::TryStreamExt;
use object_store::ObjectStore;
use percent_encoding::{AsciiSet, CONTROLS, utf8_percent_encode};
use std::io;
use url::Url;

/// Characters that must be escaped in addresses, or that paths of object stores encode differently.
const RESERVED: &AsciiSet = &CONTROLS.add(b' ').add(b'"').add(b'#').add(b'%').add(b'?').add(b'[').add(b']').add(b'\\');

/// Lists the addresses of all objects whose keys begin with the path of `address`, sorted. `address` ends in `/` or is
/// a bucket. The list holds the objects directly in it and, if `deep`, also those in what stores show as folders below
/// it. Cost: one request per thousand objects.
///
/// Memory: the list. An object that is listed but no longer exists is reported when it is opened.
pub fn list(address: &str, deep: bool) -> Result<Vec<String>> {
    let refused = |reason: String| Error::parameter("address of a folder", reason);
    let url = Url::parse(address).map_err(|error| refused(error.to_string()))?;
    let name = public_name(&url);
    refuse_tasks(&name)?;
    let bucket = format!("{}://{}", url.scheme(), url.authority());
    let options = patient();
    let connected = connect(url, &options, Use::LIST).map_err(refused)?;
    let mut failures = 0;
    let keys = loop {
        // An aborted listing starts again, so that the list is consistent.
        let found = connected.wait_for(unless_stopped(keys(&*connected.store, &connected.path, deep)));
        let failed = match found.map_err(|error| Error::io(&name, "list", error))?? {
            Ok(keys) => break keys,
            Err(error) => error,
        };
        let failure = Failure::from(failed);
        let broken = matches!(&failure, Failure::Store(error @ object_store::Error::Generic { .. })
            if cause::<Refusal>(error).is_none());
        let wait = match broken {
            true => Some(WAIT * (1 << failures.min(6))),
            false => failure.wait(failures, options.timeout),
        };
        let Some(wait) = wait.filter(|_| failures < options.retries) else {
            let error = io::Error::from(failure);
            return Err(Error::io(&name, "list", connected.explained(error)));
        };
        failures += 1;
        sleep(wait)?;
    };
    let mut found: Vec<String> =
        keys.iter().map(|key| format!("{bucket}/{}", utf8_percent_encode(key, RESERVED))).collect();
    found.sort();
    found.dedup();
    Ok(found)
}

async fn keys(
    store: &dyn ObjectStore,
    path: &object_store::path::Path,
    deep: bool,
) -> Result<Vec<String>, object_store::Error> {
    if deep {
        return store.list(Some(path)).map_ok(|object| object.location.to_string()).try_collect().await;
    }
    let found = store.list_with_delimiter(Some(path)).await?;
    Ok(found.objects.into_iter().map(|object| object.location.to_string()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_of_no_folder_are_refused_before_anything_is_sent() {
        for address in ["", "nothing", "s3://[/", "ftp://host/", "s3://anna@bucket/"] {
            let said = list(address, false).unwrap_err().to_string();
            assert!(said.starts_with("address of a folder: ") && !said.contains("anna"), "{said}");
        }
    }
}

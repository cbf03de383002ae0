//! Pages near a missing one. An answer names at most 16 missing pages: a query that needs thousands would repeat too
//! often, so nearby pages are loaded along with those named.

use slicewalk::Result;
use slicewalk::archive::Archive;
use slicewalk::frame::PageKey;

/// Returns the `most` pages of `archive` nearest to `around` among those that are `wanted`. Reads the whole directory.
pub fn nearest(
    archive: &Archive,
    around: PageKey,
    most: usize,
    wanted: impl Fn(PageKey) -> bool,
) -> Result<Vec<PageKey>> {
    let mut found = Vec::new();
    for entry in archive.entries() {
        let key = entry?.key;
        if wanted(key) {
            found.push((distance(key, around), key));
        }
    }
    if found.len() > most {
        found.select_nth_unstable(most);
        found.truncate(most);
    }
    Ok(found.into_iter().map(|(_, key)| key).collect())
}

/// Distance in pages along the axis on which they are farthest apart.
fn distance(a: PageKey, b: PageKey) -> i64 {
    let apart = |a: i32, b: i32| (i64::from(a) - i64::from(b)).abs();
    apart(a.tx, b.tx).max(apart(a.ty, b.ty)).max(apart(a.layer, b.layer))
}

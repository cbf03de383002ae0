//! Pages near to one that is missing. An answer names 16 missing pages at most: a question about thousands would be asked again so
//! often that it never came to an end, so others are loaded with those named.

use slicewalk::Result;
use slicewalk::archive::Archive;
use slicewalk::frame::PageKey;

/// Up to `most` pages of `archive` that are `wanted`, those nearest to `around`. Reads the whole directory.
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

/// In pages, along the axis on which they lie farthest apart.
fn distance(a: PageKey, b: PageKey) -> i64 {
    let apart = |a: i32, b: i32| (i64::from(a) - i64::from(b)).abs();
    apart(a.tx, b.tx).max(apart(a.ty, b.ty)).max(apart(a.layer, b.layer))
}

//! `slicetool verify`: checks every byte and lists all findings.

use crate::{Failure, Outcome};
use serde_json::json;
use slicewalk::NoMonitor;
use slicewalk::archive::{Archive, LISTED};
use std::fmt::Write;
use std::path::Path;

/// Checks the archive at `path`. Findings are the result, and a failure.
pub fn run(path: &Path, json: bool) -> Outcome {
    let mut findings = Vec::new();
    let summary = match Archive::open(path) {
        Ok(archive) => {
            let summary = archive.verify(&NoMonitor, &mut |finding| findings.push(finding.to_string()));
            Some(summary.map_err(|error| crate::broken(path, &error))?)
        }
        // What keeps an archive from opening is a finding like any other; a file that cannot be read is not.
        Err(error @ slicewalk::Error::Io { .. }) => return Err(error.into()),
        Err(error) => {
            findings.push(error.to_string());
            None
        }
    };
    let rest = summary.map_or(0, |summary| summary.findings - findings.len() as u64);
    let text = if json {
        let pages = summary.as_ref().map(|summary| summary.pages.total());
        let bytes = summary.as_ref().map(|summary| summary.bytes);
        let ok = findings.is_empty();
        let facts =
            json!({ "ok": ok, "pages": pages, "bytes": bytes, "findings": findings, "findings_not_listed": rest });
        format!("{facts:#}\n")
    } else {
        let mut text = String::new();
        for finding in &findings {
            writeln!(text, "{}: {finding}", path.display())?;
        }
        match summary {
            Some(summary) if findings.is_empty() => {
                writeln!(text, "{}: ok, {} pages, {} bytes", path.display(), summary.pages.total(), summary.bytes)?;
            }
            _ => {
                let all = findings.len() as u64 + rest;
                let noun = if all == 1 { "finding" } else { "findings" };
                let listed =
                    if rest > 0 { format!(", of each rule the first {LISTED} are listed") } else { String::new() };
                writeln!(text, "{}: {all} {noun}{listed}", path.display())?;
            }
        }
        text
    };
    if findings.is_empty() { Ok(text) } else { Err(Failure::Result(text)) }
}

//! `slicetool verify`: checks every byte and lists all findings.

use crate::{Failure, Outcome};
use serde_json::json;
use slicewalk::archive::{Archive, LISTED};
use slicewalk_base::text::{counted, one_line};
use std::fmt::Write;
use std::path::Path;

/// Checks the archive at `path`. Findings are printed as the result, and mean failure.
pub fn run(path: &Path, json: bool) -> Outcome {
    crate::standard::refuse_archive(path)?;
    let mut findings = Vec::new();
    let summary = match Archive::open(path) {
        Ok(archive) => {
            let summary = archive.verify(&crate::terminal(), &mut |finding| findings.push(finding.to_string()));
            Some(summary.map_err(|error| crate::broken(path, &error))?)
        }
        // An error that prevents opening the archive is a finding like any other; an unreadable file is not.
        Err(error @ slicewalk::Error::Io { .. }) => return Err(error.into()),
        Err(error) => {
            findings.push(match error {
                // Every line names the file already.
                slicewalk::Error::Input { reason, .. } => reason,
                error => error.to_string(),
            });
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
        let name = path.display().to_string();
        let name = one_line(&name);
        for finding in &findings {
            writeln!(text, "{name}: {}", one_line(finding))?;
        }
        match summary {
            Some(summary) if findings.is_empty() => {
                let (pages, bytes) = (counted(summary.pages.total(), "page"), counted(summary.bytes, "byte"));
                writeln!(text, "{name}: ok, {pages}, {bytes}")?;
            }
            _ => {
                let all = counted(findings.len() as u64 + rest, "finding");
                let listed =
                    if rest > 0 { format!(", of each rule the first {LISTED} are listed") } else { String::new() };
                writeln!(text, "{name}: {all}{listed}")?;
            }
        }
        text
    };
    if findings.is_empty() { Ok(text) } else { Err(Failure::Result(text)) }
}

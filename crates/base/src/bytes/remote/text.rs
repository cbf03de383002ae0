//! One-line forms of foreign text, and addresses without secrets.

use object_store::client::HttpError;
use std::error::Error;
use url::{Position, Url};

/// Most characters printed of a foreign text.
const LONGEST: usize = 240;

/// Returns the address for messages: without user, password and query.
pub(super) fn public_name(url: &Url) -> String {
    let query = if url.query().is_some() { "?…" } else { "" };
    format!("{}://{}{}{query}", url.scheme(), &url[Position::BeforeHost..Position::AfterPort], url.path())
}

/// Returns the beginning of `text` in one line, without anything that a terminal would execute.
pub(super) fn one_line(text: &str) -> String {
    let mut line = String::new();
    let words = text.split_whitespace().flat_map(|word| [" ", word]).skip(1).flat_map(str::chars);
    for (number, char) in words.enumerate() {
        if number == LONGEST {
            line.push('…');
            break;
        }
        match char.is_ascii_graphic() || char == ' ' || char.is_alphanumeric() {
            true => line.push(char),
            false => line.extend(char.escape_unicode()),
        }
    }
    line
}

/// Returns the first cause of type `E` in the chain of an error, which includes the error.
pub(super) fn cause<'a, E: Error + 'static>(error: &'a (dyn Error + 'static)) -> Option<&'a E> {
    std::iter::successors(Some(error), |&error| error.source()).find_map(|error| error.downcast_ref())
}

/// Describes a connection error by what was tried and the innermost reason. Neither names the address.
pub(super) fn connection(error: &HttpError) -> String {
    let causes: Vec<String> =
        std::iter::successors(error.source(), |&error| error.source()).map(|error| error.to_string()).collect();
    match &causes[..] {
        [] => one_line(&error.to_string()),
        [only] => one_line(only),
        [first, .., last] => one_line(&format!("{first}: {last}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use object_store::client::HttpErrorKind;

    #[derive(Debug)]
    struct Link(&'static str, Option<Box<Link>>);

    impl std::fmt::Display for Link {
        fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            f.write_str(self.0)
        }
    }

    impl Error for Link {
        fn source(&self) -> Option<&(dyn Error + 'static)> {
            self.1.as_ref().map(|inner| &**inner as &(dyn Error + 'static))
        }
    }

    #[test]
    fn the_first_and_the_innermost_reason_describe_a_failed_connection() {
        for (causes, expected) in [
            (&["connection\nrefused"][..], "connection refused"),
            (&["error sending request", "connection refused"][..], "error sending request: connection refused"),
            (&["error sending request", "http://host/a", "refused"][..], "error sending request: refused"),
        ] {
            let chain = causes.iter().rev().fold(None, |inner, &text| Some(Box::new(Link(text, inner))));
            assert_eq!(connection(&HttpError::new(HttpErrorKind::Connect, *chain.unwrap())), expected);
        }
    }

    #[test]
    fn lines_are_short_and_harmless() {
        assert_eq!(one_line(" a\n\t b\r\n"), "a b");
        assert_eq!(one_line("é\u{1b}[2J\u{202e}\0"), r"é\u{1b}[2J\u{202e}\u{0}");
        assert_eq!(one_line(&"x".repeat(1000)).chars().count(), LONGEST + 1);
        assert_eq!(one_line(&"x".repeat(LONGEST)), "x".repeat(LONGEST));
    }

    #[test]
    fn names_hold_no_secrets() {
        let name = |address: &str| public_name(&Url::parse(address).unwrap());
        assert_eq!(name("https://user:secret@host:81/a%2Fb?key=secret#c"), "https://host:81/a%2Fb?…");
        assert_eq!(name("file:///a/b"), "file:///a/b");
    }
}

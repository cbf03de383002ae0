//! Dependencies between the modules of the library point one way: a module uses those listed above it, never those below.
//!
//! The order is that of the code map in docs/ARCHITECTURE.md. Every path that begins with `crate` or `super` counts: in
//! `use`, in expressions, inside macros. Comments and tests may use lower modules.

use proc_macro2::{Delimiter, Group, Ident, TokenStream, TokenTree};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Modules of the names that `lib.rs` re-exports.
const RE_EXPORTS: [(&str, &str); 6] = [
    ("Error", "error"),
    ("Parameter", "error"),
    ("Result", "error"),
    ("Monitor", "monitor"),
    ("NoMonitor", "monitor"),
    ("Warning", "monitor"),
];

/// Modules that each module uses, each with a file that uses it.
type Uses = BTreeMap<String, BTreeMap<String, String>>;

#[test]
fn modules_use_only_those_above_them_in_the_code_map() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let map = std::fs::read_to_string(root.join("docs/ARCHITECTURE.md")).unwrap();
    let broken = broken_rules(&uses_below(&root.join("src")), &order_in(&map));
    assert!(broken.is_empty(), "{broken:#?}");
}

#[test]
fn paths_are_found_wherever_they_stand() {
    let text = "use crate::{plan::{Plan, Up}, Result}; #[cfg(test)] mod tests { use crate::walk::Walker; }
                fn f() { assert!(crate::query::g(super::h())); let x: super::super::store::Store; } // crate::object";
    let mut found = BTreeSet::new();
    collect(text.parse().unwrap(), &mut vec!["archive".into(), "reader".into()], &mut found);
    assert_eq!(found.into_iter().collect::<Vec<_>>(), ["Result", "archive", "plan", "query", "store"]);
    let uses = Uses::from([("archive".into(), BTreeMap::from([("query".into(), "archive/reader.rs".into())]))]);
    let order = ["archive", "query"].map(str::to_owned);
    assert_eq!(broken_rules(&uses, &order), ["archive uses query, which lies below it (archive/reader.rs)"]);
}

/// Modules in the order of the code map.
fn order_in(map: &str) -> Vec<String> {
    let listed = map.lines().filter(|line| line.starts_with("src/"));
    let names =
        listed.flat_map(|line| line.split_whitespace().take_while(|word| word.ends_with('/') || word.ends_with(".rs")));
    let name = |word: &str| word.trim_start_matches("src/").trim_end_matches('/').trim_end_matches(".rs").to_owned();
    names.map(name).collect()
}

fn broken_rules(uses: &Uses, order: &[String]) -> Vec<String> {
    let place = |module: &str| order.iter().position(|listed| listed == module);
    let mut broken = Vec::new();
    for (module, used) in uses {
        let Some(own) = place(module) else {
            broken.push(format!("{module} is not in the code map"));
            continue;
        };
        for (name, file) in used {
            let name = RE_EXPORTS.iter().find(|(export, _)| export == name).map_or(name.as_str(), |(_, home)| home);
            if name != module && place(name).is_none_or(|place| place > own) {
                broken.push(format!("{module} uses {name}, which lies below it ({file})"));
            }
        }
    }
    broken
}

fn uses_below(src: &Path) -> Uses {
    let mut uses = Uses::new();
    let mut folders = vec![src.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let relative = path.strip_prefix(src).unwrap();
            let mut module: Vec<String> =
                relative.with_extension("").iter().map(|part| part.to_str().unwrap().to_owned()).collect();
            if module.last().is_some_and(|last| last == "mod") {
                module.pop();
            }
            // Programs and the crate's root may use everything.
            if module[0] == "bin" || module[0] == "lib" || module.last().is_some_and(|last| last == "tests") {
                continue;
            }
            let text = std::fs::read_to_string(&path).unwrap();
            let tokens: TokenStream = text.parse().unwrap_or_else(|error| panic!("{}: {error}", path.display()));
            let mut found = BTreeSet::new();
            collect(tokens, &mut module, &mut found);
            let used = uses.entry(module[0].clone()).or_default();
            for name in found {
                used.entry(name).or_insert_with(|| relative.display().to_string());
            }
        }
    }
    uses
}

/// Adds the top-level modules named by `tokens`, found in `module`.
fn collect(tokens: TokenStream, module: &mut Vec<String>, found: &mut BTreeSet<String>) {
    let tokens: Vec<TokenTree> = tokens.into_iter().collect();
    let ident = |at: usize| match tokens.get(at) {
        Some(TokenTree::Ident(ident)) => Some(ident.to_string()),
        _ => None,
    };
    let mut at = 0;
    while at < tokens.len() {
        match &tokens[at] {
            // `mod name { … }`, skipped after `#[cfg(test)]`.
            TokenTree::Ident(word) if word == "mod" => {
                if let (Some(name), Some(TokenTree::Group(body))) = (ident(at + 1), tokens.get(at + 2)) {
                    if name != "tests" {
                        module.push(name);
                        collect(body.stream(), module, found);
                        module.pop();
                    }
                    at += 2;
                }
            }
            TokenTree::Ident(word) if starts_path(word, at, &tokens) => {
                let (base, next) = base_of(module, at, &tokens);
                name_after(&base, &tokens[next..], found);
                at = next - 1;
            }
            TokenTree::Group(group) => collect(group.stream(), module, found),
            _ => {}
        }
        at += 1;
    }
}

/// Returns whether `word` begins a path of this crate, unlike the `crate` of `pub(crate)`.
fn starts_path(word: &Ident, at: usize, tokens: &[TokenTree]) -> bool {
    (word == "crate" || word == "super") && is_separator(tokens, at + 1)
}

fn is_colon(token: &TokenTree) -> bool {
    matches!(token, TokenTree::Punct(punct) if punct.as_char() == ':')
}

fn is_separator(tokens: &[TokenTree], at: usize) -> bool {
    tokens.get(at).is_some_and(is_colon) && tokens.get(at + 1).is_some_and(is_colon)
}

/// Resolves the leading `crate` or `super`s at `at` to a module; also returns where the path continues.
fn base_of(module: &[String], mut at: usize, tokens: &[TokenTree]) -> (Vec<String>, usize) {
    let mut base = module.to_vec();
    while let Some(TokenTree::Ident(word)) = tokens.get(at)
        && is_separator(tokens, at + 1)
    {
        match word.to_string().as_str() {
            "crate" => base.clear(),
            "super" => drop(base.pop()),
            _ => break,
        }
        at += 3;
    }
    (base, at)
}

/// Adds the top-level modules of the path, or the tree of paths, that follows `base`.
fn name_after(base: &[String], rest: &[TokenTree], found: &mut BTreeSet<String>) {
    if let Some(first) = base.first() {
        found.insert(first.clone());
        return;
    }
    match rest.first() {
        Some(TokenTree::Ident(name)) => drop(found.insert(name.to_string())),
        Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::Brace => {
            for branch in branches(group) {
                name_after(base, &branch, found);
            }
        }
        _ => {}
    }
}

/// Splits `{a, b::c}` at its commas.
fn branches(group: &Group) -> Vec<Vec<TokenTree>> {
    let tokens: Vec<TokenTree> = group.stream().into_iter().collect();
    let comma = |token: &TokenTree| matches!(token, TokenTree::Punct(punct) if punct.as_char() == ',');
    tokens.split(comma).map(<[TokenTree]>::to_vec).collect()
}

//! The mutants of a source file: what a person may get wrong there, each behind a switch.
//!
//! Most kinds of `cargo-mutants` are here: a function that returns a plain value at once, another operator, an operator left out, a
//! guard that always or never holds, an arm of a `match` left out. All mutants of a file stand in one text: each change is an
//! insertion, so changes within changes need no care. Macros, constants and `const fn` are left as they are: what is known
//! before the program runs cannot be switched.

use proc_macro2::{LineColumn, Span};
use quote::ToTokens;
use std::ops::Range;
use syn::spanned::Spanned;
use syn::visit::{self, Visit};
use syn::{Attribute, BinOp, Block, Expr, ReturnType, Signature, Type, UnOp};

/// A change of one place.
#[derive(Debug, Clone)]
pub struct Mutant {
    /// Line and column of what is changed, from 1 on.
    pub at: (usize, usize),
    /// What is done to it.
    pub change: String,
    /// The place that this change and others of it share, as bytes of the file.
    pub place: Range<usize>,
    kind: Kind,
}

#[derive(Debug, Clone)]
enum Kind {
    /// Returns this at once; the position of the block's first byte.
    Returns(usize, String),
    /// Says this in place of the expression.
    Says(String),
    /// The guard is this; whole guards lie at the place.
    Guard(bool),
    /// An arm without a guard gets one that fails, behind its pattern.
    Arm,
}

/// The mutants of a file.
pub fn mutants(text: &str) -> syn::Result<Vec<Mutant>> {
    let file = syn::parse_file(text)?;
    let mut lines = vec![0];
    lines.extend(text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n').map(|(at, _)| at + 1));
    let mut finder = Finder { text, lines, found: Vec::new() };
    finder.visit_file(&file);
    Ok(finder.found)
}

/// The file with those mutants that `number` gives a number, each behind its switch. Beside it, the bytes of the new text that
/// each of them stands in.
pub fn switched(
    text: &str,
    mutants: &[Mutant],
    number: impl Fn(usize) -> Option<u32>,
) -> (String, Vec<(u32, Range<usize>)>) {
    // Insertions by place; at one place, what closes comes first, the innermost before those around it, and what opens from the
    // outermost on.
    let mut insertions: Vec<([i64; 3], Vec<Part>)> = Vec::new();
    let mut at = 0;
    while at < mutants.len() {
        let (place, is_guard) = (mutants[at].place.clone(), matches!(mutants[at].kind, Kind::Guard(_)));
        let is_same = |mutant: &&Mutant| mutant.place == place && matches!(mutant.kind, Kind::Guard(_)) == is_guard;
        let (same, index) = (mutants[at..].iter().take_while(is_same).count(), at as i64);
        let chosen: Vec<_> = (at..at + same).filter_map(|index| Some((number(index)?, &mutants[index]))).collect();
        at += same;
        let len = place.len() as i64;
        let (mut opens, mut closes) = (Vec::new(), Vec::new());
        let mut opens_at = place.start;
        for (number, mutant) in &chosen {
            let test = format!("crate::mutant::is_active({number})");
            match &mutant.kind {
                Kind::Returns(body, value) => {
                    opens_at = *body;
                    opens.push(Part::Of(*number, format!(" if {test} {{ return {value}; }}")));
                }
                Kind::Says(says) => {
                    let start = if opens.is_empty() { "(if" } else { "else if" };
                    opens.push(Part::Of(*number, format!("{start} {test} {{ {says} }} ")));
                }
                Kind::Guard(holds) => {
                    let (start, joint) = if *holds { ("(", "||") } else { ("(!", "&&") };
                    opens.push(Part::Of(*number, format!("{start}{test} {joint} ")));
                    closes.push(Part::Fixed(")".into()));
                }
                Kind::Arm => closes.push(Part::Of(*number, format!(" if !{test}"))),
            }
        }
        if chosen.iter().any(|(_, mutant)| matches!(mutant.kind, Kind::Says(_))) {
            opens.push(Part::Fixed("else { ".into()));
            closes.push(Part::Fixed(" })".into()));
        }
        insertions.push(([opens_at as i64, i64::MAX - len, index], opens));
        insertions.push(([place.end as i64, len, -index], closes));
    }
    insertions.sort_by_key(|(order, _)| *order);
    let (mut out, mut done, mut ranges) = (String::new(), 0, Vec::new());
    for ([at, ..], parts) in insertions {
        let at = at as usize;
        out.push_str(&text[done..at]);
        done = at;
        for part in parts {
            let start = out.len();
            match part {
                Part::Fixed(text) => out.push_str(&text),
                Part::Of(number, text) => {
                    out.push_str(&text);
                    ranges.push((number, start..out.len()));
                }
            }
        }
    }
    out.push_str(&text[done..]);
    (out, ranges)
}

enum Part {
    Fixed(String),
    Of(u32, String),
}

struct Finder<'a> {
    text: &'a str,
    /// Where each line begins.
    lines: Vec<usize>,
    found: Vec<Mutant>,
}

impl Finder<'_> {
    fn byte(&self, at: LineColumn) -> usize {
        let start = self.lines[at.line - 1];
        let line = &self.text[start..];
        start + line.char_indices().nth(at.column).map_or(line.len(), |(byte, _)| byte)
    }

    fn range(&self, span: Span) -> Range<usize> {
        self.byte(span.start())..self.byte(span.end())
    }

    fn add(&mut self, span: Span, place: Range<usize>, change: String, kind: Kind) {
        let start = span.start();
        self.found.push(Mutant { at: (start.line, start.column + 1), change, place, kind });
    }

    fn function(&mut self, signature: &Signature, block: &Block) {
        let body = self.byte(block.brace_token.span.open().end());
        for value in plain_values(&signature.output) {
            let change = format!("{} returns {}", signature.ident, if value.is_empty() { "at once" } else { &value });
            // Of no length: nothing of the body lies within.
            self.add(signature.ident.span(), body..body, change, Kind::Returns(body, value));
        }
        visit::visit_block(self, block);
    }
}

/// Whether an item is a test, or stands only in builds without a feature: tests run with all of them.
fn is_left_out(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        let text = attribute.to_token_stream().to_string();
        let is_condition = text.starts_with("# [cfg (");
        text.starts_with("# [test") || is_condition && (text.contains("test") || text.contains("not (feature"))
    })
}

impl<'ast> Visit<'ast> for Finder<'_> {
    fn visit_item_fn(&mut self, item: &'ast syn::ItemFn) {
        if !is_left_out(&item.attrs) && item.sig.constness.is_none() && item.sig.unsafety.is_none() {
            self.function(&item.sig, &item.block);
        }
    }

    fn visit_impl_item_fn(&mut self, item: &'ast syn::ImplItemFn) {
        if !is_left_out(&item.attrs) && item.sig.constness.is_none() && item.sig.unsafety.is_none() {
            self.function(&item.sig, &item.block);
        }
    }

    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        if !is_left_out(&item.attrs) {
            visit::visit_item_mod(self, item);
        }
    }

    fn visit_item_impl(&mut self, item: &'ast syn::ItemImpl) {
        let is_debug = item
            .trait_
            .as_ref()
            .is_some_and(|(_, path, _)| path.segments.last().is_some_and(|name| name.ident == "Debug"));
        if !is_left_out(&item.attrs) && !is_debug {
            visit::visit_item_impl(self, item);
        }
    }

    fn visit_item_const(&mut self, _: &'ast syn::ItemConst) {}
    fn visit_item_static(&mut self, _: &'ast syn::ItemStatic) {}
    fn visit_item_enum(&mut self, _: &'ast syn::ItemEnum) {}
    fn visit_item_struct(&mut self, _: &'ast syn::ItemStruct) {}
    fn visit_impl_item_const(&mut self, _: &'ast syn::ImplItemConst) {}
    fn visit_type(&mut self, _: &'ast Type) {}
    fn visit_pat(&mut self, _: &'ast syn::Pat) {}
    fn visit_generic_argument(&mut self, _: &'ast syn::GenericArgument) {}
    fn visit_expr_repeat(&mut self, repeat: &'ast syn::ExprRepeat) {
        self.visit_expr(&repeat.expr);
    }

    fn visit_expr_binary(&mut self, expr: &'ast syn::ExprBinary) {
        let has_pattern = |side: &Expr| {
            let mut side = side;
            loop {
                match side {
                    Expr::Let(_) => break true,
                    Expr::Binary(inner) if matches!(inner.op, BinOp::And(_)) => {
                        if matches!(*inner.right, Expr::Let(_)) {
                            break true;
                        }
                        side = &inner.left;
                    }
                    _ => break false,
                }
            }
        };
        let others = other_operators(&expr.op);
        let assigns = others.iter().all(|other| is_assignment(other));
        if !has_pattern(&expr.left) && !has_pattern(&expr.right) {
            let place = self.range(expr.span());
            let operator = self.range(expr.op.span());
            let [left, right] =
                [place.start..operator.start, operator.end..place.end].map(|side| self.text[side].to_string());
            let old = self.text[operator].to_string();
            for other in others {
                // In parentheses each side stays what it was, whatever binds tighter now.
                let says = if assigns {
                    format!("{left}{other}{right}")
                } else {
                    format!("({}) {other} ({})", left.trim(), right.trim())
                };
                let kind = Kind::Says(says);
                self.add(expr.op.span(), place.clone(), format!("{old} becomes {other}"), kind);
            }
        }
        visit::visit_expr_binary(self, expr);
    }

    fn visit_expr_unary(&mut self, expr: &'ast syn::ExprUnary) {
        let is_literal = matches!(*expr.expr, Expr::Lit(_));
        if matches!(expr.op, UnOp::Not(_) | UnOp::Neg(_)) && !is_literal {
            let inner = self.text[self.range(expr.expr.span())].to_string();
            let old = self.text[self.range(expr.op.span())].to_string();
            self.add(expr.op.span(), self.range(expr.span()), format!("{old} is left out"), Kind::Says(inner));
        }
        visit::visit_expr_unary(self, expr);
    }

    fn visit_expr_match(&mut self, expr: &'ast syn::ExprMatch) {
        let has_rest = expr.arms.iter().any(|arm| arm.guard.is_none() && matches!(arm.pat, syn::Pat::Wild(_)));
        for arm in &expr.arms {
            let pattern = arm.pat.span();
            match &arm.guard {
                Some((_, guard)) if !guard.to_token_stream().to_string().contains("let ") => {
                    let place = self.range(guard.span());
                    for holds in [true, false] {
                        self.add(guard.span(), place.clone(), format!("guard is {holds}"), Kind::Guard(holds));
                    }
                }
                None if has_rest && !matches!(arm.pat, syn::Pat::Wild(_)) => {
                    let end = self.range(pattern).end;
                    self.add(pattern, end..end, "arm is left out".into(), Kind::Arm);
                }
                _ => {}
            }
        }
        visit::visit_expr_match(self, expr);
    }
}

fn is_assignment(operator: &str) -> bool {
    operator.ends_with('=') && !["==", "!=", "<=", ">="].contains(&operator)
}

fn other_operators(operator: &BinOp) -> &'static [&'static str] {
    match operator {
        BinOp::Eq(_) => &["!="],
        BinOp::Ne(_) => &["=="],
        BinOp::And(_) => &["||"],
        BinOp::Or(_) => &["&&"],
        BinOp::Lt(_) => &["==", ">", "<="],
        BinOp::Gt(_) => &["==", "<", ">="],
        BinOp::Le(_) => &[">"],
        BinOp::Ge(_) => &["<"],
        BinOp::Add(_) => &["-", "*"],
        BinOp::Sub(_) => &["+", "/"],
        BinOp::Mul(_) => &["+", "/"],
        BinOp::Div(_) => &["%", "*"],
        BinOp::Rem(_) => &["/", "+"],
        BinOp::Shl(_) => &[">>"],
        BinOp::Shr(_) => &["<<"],
        BinOp::BitAnd(_) => &["|", "^"],
        BinOp::BitOr(_) => &["&", "^"],
        BinOp::BitXor(_) => &["|", "&"],
        BinOp::AddAssign(_) => &["-=", "*="],
        BinOp::SubAssign(_) => &["+=", "/="],
        BinOp::MulAssign(_) => &["+=", "/="],
        BinOp::DivAssign(_) => &["%=", "*="],
        BinOp::ShlAssign(_) => &[">>="],
        BinOp::ShrAssign(_) => &["<<="],
        BinOp::BitAndAssign(_) => &["|=", "^="],
        BinOp::BitOrAssign(_) => &["&=", "^="],
        BinOp::BitXorAssign(_) => &["|=", "&="],
        _ => &[],
    }
}

/// What a function may return without having worked.
fn plain_values(output: &ReturnType) -> Vec<String> {
    match output {
        ReturnType::Default => vec![String::new()],
        ReturnType::Type(_, kind) => values_of(kind),
    }
}

fn values_of(kind: &Type) -> Vec<String> {
    match kind {
        Type::Tuple(tuple) if tuple.elems.is_empty() => vec!["()".into()],
        Type::Tuple(tuple) => {
            let first = |kind: &Type| values_of(kind).into_iter().next();
            let values: Option<Vec<_>> = tuple.elems.iter().map(first).collect();
            values.map(|values| format!("({},)", values.join(", "))).into_iter().collect()
        }
        Type::Array(array) => {
            let len = array.len.to_token_stream();
            values_of(&array.elem)
                .into_iter()
                .map(|value| format!("std::array::from_fn::<_, {{ {len} }}, _>(|_| {value})"))
                .collect()
        }
        Type::Path(path) => {
            let Some(last) = path.path.segments.last() else { return Vec::new() };
            let arguments: Vec<_> = match &last.arguments {
                syn::PathArguments::AngleBracketed(list) => list
                    .args
                    .iter()
                    .filter_map(|arg| if let syn::GenericArgument::Type(kind) = arg { Some(kind) } else { None })
                    .collect(),
                _ => Vec::new(),
            };
            let inner = || arguments.first().map_or_else(Vec::new, |kind| values_of(kind));
            match last.ident.to_string().as_str() {
                "bool" => vec!["true".into(), "false".into()],
                "u8" | "u16" | "u32" | "u64" | "u128" | "usize" => vec!["0".into(), "1".into()],
                "i8" | "i16" | "i32" | "i64" | "i128" | "isize" => vec!["0".into(), "1".into(), "-1".into()],
                "f32" | "f64" => vec!["0.0".into(), "1.0".into(), "-1.0".into()],
                "String" => vec!["String::new()".into(), "\"xyzzy\".into()".into()],
                "Vec" => vec!["Vec::new()".into()],
                "Option" => ["None".into()]
                    .into_iter()
                    .chain(inner().into_iter().map(|value| format!("Some({value})")))
                    .collect(),
                "Result" => inner().into_iter().map(|value| format!("Ok({value})")).collect(),
                _ => vec!["Default::default()".into()],
            }
        }
        Type::Reference(reference) if reference.mutability.is_none() => match &*reference.elem {
            Type::Path(path) if path.path.is_ident("str") => vec!["\"\"".into(), "\"xyzzy\"".into()],
            Type::Slice(_) => vec!["&[]".into()],
            _ => Vec::new(),
        },
        _ => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn changes(text: &str) -> Vec<String> {
        mutants(text).unwrap().into_iter().map(|mutant| mutant.change).collect()
    }

    fn all_switched(text: &str) -> String {
        let found = mutants(text).unwrap();
        switched(text, &found, |index| u32::try_from(index + 1).ok()).0.replace("crate::mutant::is_active", "on")
    }

    #[test]
    fn each_kind_of_change_is_found_once() {
        assert_eq!(changes("fn f(a: u8) -> bool { a == 1 }"), ["f returns true", "f returns false", "== becomes !="]);
        assert_eq!(changes("fn f(a: u8) { g(!a) }"), ["f returns at once", "! is left out"]);
        let text = "fn f(a: u8) -> X<u8> { match a { 1 if b() => c, 2 => d, _ => e } }";
        assert_eq!(changes(text)[1..], ["guard is true", "guard is false", "arm is left out"]);
        assert_eq!(changes("fn f() -> Result<Option<i8>> { g }").len(), 4);
    }

    #[test]
    fn what_cannot_be_switched_stays() {
        assert_eq!(changes("const A: u8 = 1 + 2; const fn f() -> u8 { 1 + 2 }"), [""; 0]);
        assert_eq!(changes("#[cfg(test)] mod tests { fn f() {} } #[test] fn g() {}"), [""; 0]);
        assert_eq!(changes("#[cfg(not(feature = \"remote\"))] fn f() {}"), [""; 0]);
        assert_eq!(changes("#[cfg(feature = \"remote\")] fn f() {}").len(), 1);
        assert_eq!(changes("unsafe fn f() { a + b; }"), [""; 0]);
        assert_eq!(changes("fn f() -> &mut u8 { if let Some(a) = b && c { d } else { [0; 1 + 2] } }"), [""; 0]);
    }

    #[test]
    fn switches_stand_around_what_they_change() {
        let text = "fn f() -> &mut u8 { a + b * c }";
        let sum = "(if on(1) { (a) - (b * c) } else if on(2) { (a) * (b * c) } else { ";
        let product = "(if on(3) { (b) + (c) } else if on(4) { (b) / (c) } else { b * c })";
        assert_eq!(all_switched(text), format!("fn f() -> &mut u8 {{ {sum}a + {product} }}) }}"));
        let text = "fn f() { match a { b if c == d => e } }";
        let guard = "(on(2) || (!on(3) && (if on(4) { (c) != (d) } else { c == d })))";
        assert_eq!(all_switched(text), format!("fn f() {{ if on(1) {{ return ; }} match a {{ b if {guard} => e }} }}"));
        let text = "fn f() -> &mut u8 { match a { b => c, _ => d } }";
        assert_eq!(all_switched(text), "fn f() -> &mut u8 { match a { b if !on(1) => c, _ => d } }");
    }

    /// The library's own sources: without numbers nothing changes, with all of them each file is Rust still.
    #[test]
    fn sources_of_the_library_can_be_switched() {
        let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../src");
        for name in ["frame.rs", "codec/braid.rs", "archive/head.rs", "query/floor.rs", "reach/route.rs"] {
            let Ok(text) = std::fs::read_to_string(format!("{root}/{name}")) else { continue };
            let found = mutants(&text).unwrap();
            assert!(found.len() > 20, "{name}: {}", found.len());
            assert_eq!(switched(&text, &found, |_| None).0, text);
            let (all, ranges) = switched(&text, &found, |index| u32::try_from(index).ok());
            if let Err(error) = syn::parse_file(&all) {
                let line = all.lines().nth(error.span().start().line - 1);
                panic!("{name}: {error}: {line:?}");
            }
            assert_eq!(ranges.len(), found.len());
        }
    }
}

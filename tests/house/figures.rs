//! The figures of a tree of sources. Each function is one of them.

use std::collections::{BTreeMap, BTreeSet};

use crate::imports::{ChildImports, circles};
use crate::lexer::Token;
use crate::sources::{SourceFile, SourceTree, closing, starts_with};

/// From here on a struct is too wide to be read at a glance.
pub(crate) const MANY_FIELDS: usize = 12;

/// Lines of product code, with comments and blank lines, without test code.
pub(crate) fn product_lines(tree: &SourceTree) -> f64 {
    tree.files.iter().map(|file| file.product_lines).sum::<usize>() as f64
}

/// Files that hold product code.
pub(crate) fn product_files(tree: &SourceTree) -> f64 {
    tree.files.iter().filter(|file| file.product_lines > 0).count() as f64
}

/// Lines of test code under the same `src`: items under `#[cfg(test)]`, files `tests.rs` and files in `tests/`.
pub(crate) fn test_lines(tree: &SourceTree) -> f64 {
    tree.files.iter().map(|file| file.test_lines).sum::<usize>() as f64
}

/// Structs, enums, traits and unions of any visibility; type aliases are none, nor are the types that only a macro names.
pub(crate) fn types(tree: &SourceTree) -> f64 {
    definitions(tree).len() as f64
}

/// Distinct names of types.
pub(crate) fn type_names(tree: &SourceTree) -> f64 {
    definitions(tree).iter().map(|item| &item.name).collect::<BTreeSet<_>>().len() as f64
}

/// Types whose name occurs at least twice in the workspace, percent of all types.
pub(crate) fn shared_names(tree: &SourceTree) -> f64 {
    percent_shared(&definitions(tree))
}

/// Types whose name is one word of CamelCase, percent of all types.
pub(crate) fn one_word_names(tree: &SourceTree) -> f64 {
    percent_one_word(&definitions(tree))
}

/// `pub(super)`, `pub(crate)` and `pub(in ..)` per 1000 lines of product code.
pub(crate) fn restricted_pub(tree: &SourceTree) -> f64 {
    per_1000_lines(tree, is_restricted)
}

/// `pub` without a restriction per 1000 lines of product code.
pub(crate) fn plain_pub(tree: &SourceTree) -> f64 {
    per_1000_lines(tree, |behind| !is_restricted(behind))
}

/// Structs with many fields that are neither options of a command nor a file format.
pub(crate) fn wide_structs(tree: &SourceTree) -> f64 {
    wide(tree, StructUse::Inside).len() as f64
}

/// Structs with many fields that hold the options of a command.
pub(crate) fn wide_option_structs(tree: &SourceTree) -> f64 {
    wide(tree, StructUse::Options).len() as f64
}

/// Structs with many fields that are written to or read from a file or page.
pub(crate) fn wide_format_structs(tree: &SourceTree) -> f64 {
    wide(tree, StructUse::FileFormat).len() as f64
}

/// Groups of files that import each other in a circle.
pub(crate) fn import_circles(tree: &SourceTree) -> f64 {
    circles(tree, ChildImports::Count).len() as f64
}

/// Files in such groups.
pub(crate) fn files_in_circles(tree: &SourceTree) -> f64 {
    circles(tree, ChildImports::Count).iter().map(Vec::len).sum::<usize>() as f64
}

/// Files of the largest such group.
pub(crate) fn largest_circle(tree: &SourceTree) -> f64 {
    circles(tree, ChildImports::Count).first().map_or(0.0, |group| group.len() as f64)
}

/// As [`import_circles`], where what a file imports from its own child modules does not count.
pub(crate) fn import_knots(tree: &SourceTree) -> f64 {
    circles(tree, ChildImports::Ignore).len() as f64
}

/// Files in such groups.
pub(crate) fn files_in_knots(tree: &SourceTree) -> f64 {
    circles(tree, ChildImports::Ignore).iter().map(Vec::len).sum::<usize>() as f64
}

/// `#[test]` functions beside the code: under the `src` of a crate.
pub(crate) fn tests_beside_code(tree: &SourceTree) -> f64 {
    tree.files.iter().map(|file| count_tests(&file.tests)).sum::<usize>() as f64
}

/// The number of `#[test]` functions of each directory that has any: a `src`, or two steps below the top.
pub(crate) fn tests_by_directory(tree: &SourceTree) -> BTreeMap<String, usize> {
    let beside = tree.files.iter().map(|file| (file.crate_and_place().0.to_owned(), &file.tests));
    let elsewhere = tree.others.iter().map(|file| {
        let directory = file.path.rsplit_once('/').map_or(".", |(directory, _)| directory);
        (directory.split('/').take(2).collect::<Vec<_>>().join("/"), &file.tokens)
    });
    let mut counts = BTreeMap::new();
    for (directory, tokens) in beside.chain(elsewhere) {
        *counts.entry(directory).or_default() += count_tests(tokens);
    }
    counts.retain(|_, count| *count > 0);
    counts
}

/// What a struct is for, by its derives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum StructUse {
    Options,
    FileFormat,
    Inside,
}

/// A struct, enum, trait or union.
pub(crate) struct TypeDefinition {
    pub(crate) name: String,
    pub(crate) path: String,
    /// Of a struct.
    pub(crate) named_fields: usize,
    struct_use: StructUse,
}

/// The structs of this use with many fields, the widest first.
pub(crate) fn wide(tree: &SourceTree, wanted: StructUse) -> Vec<TypeDefinition> {
    let mut found = definitions(tree);
    found.retain(|item| item.named_fields >= MANY_FIELDS && item.struct_use == wanted);
    found.sort_by(|a, b| b.named_fields.cmp(&a.named_fields).then_with(|| a.name.cmp(&b.name)));
    found
}

fn definitions(tree: &SourceTree) -> Vec<TypeDefinition> {
    tree.files.iter().flat_map(definitions_in).collect()
}

fn definitions_in(file: &SourceFile) -> Vec<TypeDefinition> {
    let tokens = &file.product;
    let mut found = Vec::new();
    for (at, pair) in tokens.windows(2).enumerate() {
        let [keyword, name] = pair else { continue };
        // `union` is a keyword nowhere else.
        let defines = match keyword.text.as_str() {
            "struct" | "enum" | "trait" => true,
            "union" => tokens.get(at + 2).is_some_and(|next| next.is("{") || next.is("<")),
            _ => false,
        };
        if defines && name.is_word() {
            let named_fields = if keyword.is("struct") { named_fields(&tokens[at..]) } else { 0 };
            let (name, path) = (name.text.clone(), file.path.clone());
            found.push(TypeDefinition { name, path, named_fields, struct_use: struct_use(&tokens[..at]) });
        }
    }
    found
}

/// Fields of the struct that begins here: words before a single colon, behind the brace or a comma.
fn named_fields(tokens: &[Token]) -> usize {
    let Some(open) = tokens.iter().position(|token| ["{", "(", ";"].iter().any(|sign| token.is(sign))) else {
        return 0;
    };
    if !tokens[open].is("{") {
        return 0;
    }
    let end = closing(tokens, open);
    let mut count = 0;
    let mut at = open + 1;
    let mut is_start = true;
    while at < end {
        if is_start && tokens[at].is_word() && tokens[at + 1].is(":") {
            count += 1;
        }
        // Attributes and visibility stand before the name; brackets of a type hold no field.
        match tokens[at].text.as_str() {
            "#" | "pub" => {}
            "(" | "[" => at = closing(tokens, at),
            sign => is_start = sign == ",",
        }
        at += 1;
    }
    count
}

/// By the attributes at the end of what stands before the keyword.
fn struct_use(before: &[Token]) -> StructUse {
    let attributes =
        before.rsplit(|token| [";", "}", "{"].iter().any(|sign| token.is(sign))).next().unwrap_or(&[]);
    let derives = |names: &[&str]| {
        let mut rest = attributes;
        while let Some(at) = rest.iter().position(|token| token.is("derive")) {
            let end = closing(rest, at + 1);
            if rest[at..end].iter().any(|token| names.contains(&token.text.as_str())) {
                return true;
            }
            rest = &rest[end..];
        }
        false
    };
    if derives(&["Args", "Parser"]) {
        StructUse::Options
    } else if derives(&["Serialize", "Deserialize"]) {
        StructUse::FileFormat
    } else {
        StructUse::Inside
    }
}

fn percent_shared(types: &[TypeDefinition]) -> f64 {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for item in types {
        *counts.entry(&item.name).or_default() += 1;
    }
    percent(counts.values().filter(|count| **count > 1).sum(), types.len())
}

fn percent_one_word(types: &[TypeDefinition]) -> f64 {
    percent(types.iter().filter(|item| words(&item.name) == 1).count(), types.len())
}

fn percent(part: usize, whole: usize) -> f64 {
    100.0 * part as f64 / whole.max(1) as f64
}

/// Words of a name in CamelCase: a capital begins one unless it continues a row of capitals, as the L of `HTML`.
fn words(name: &str) -> usize {
    let letters: Vec<char> = name.chars().collect();
    let begins = |i: &usize| {
        letters[*i].is_uppercase()
            && (*i == 0
                || !letters[i - 1].is_uppercase()
                || letters.get(i + 1).is_some_and(|next| next.is_lowercase()))
    };
    (0..letters.len()).filter(begins).count()
}

/// How often `pub` stands before tokens that are wanted, per 1000 lines of product code.
fn per_1000_lines(tree: &SourceTree, is_wanted: impl Fn(&[Token]) -> bool) -> f64 {
    let places = tree.files.iter().flat_map(|file| (0..file.product.len()).map(|at| &file.product[at..]));
    let count = places.filter(|tokens| tokens[0].is("pub") && is_wanted(&tokens[1..])).count();
    1000.0 * count as f64 / product_lines(tree).max(1.0)
}

/// `pub (A, B)` is a plain field of a tuple's type.
fn is_restricted(behind_pub: &[Token]) -> bool {
    ["super", "crate", "self", "in"].iter().any(|scope| starts_with(behind_pub, &["(", scope]))
}

fn count_tests(tokens: &[Token]) -> usize {
    (0..tokens.len()).filter(|at| starts_with(&tokens[*at..], &["#", "[", "test", "]"])).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tree(text: &str) -> SourceTree {
        SourceTree::from_texts([("src/a.rs", text.to_owned())])
    }

    #[test]
    fn types_are_counted_by_name() {
        let tree =
            tree("struct Step; mod m { enum Step {} trait TcpPort {} } union U { a: u8 } type Step = u8;");
        assert_eq!((types(&tree), type_names(&tree)), (4.0, 3.0));
        assert_eq!((shared_names(&tree), one_word_names(&tree)), (50.0, 75.0));
    }

    #[test]
    fn words_begin_with_capitals() {
        assert_eq!(["Step", "DhRow", "HTML", "HTMLPage", "A", "Crc16"].map(words), [1, 2, 1, 2, 1, 1]);
    }

    #[test]
    fn fields_are_counted_and_derives_read() {
        let fields = |text: &str| definitions(&tree(text))[0].named_fields;
        assert_eq!(
            fields("struct A<T: B> { #[c(d, e: f)] pub a: [u8; 3], pub(in x::y) b: Map<T, z::Q>, c: T }"),
            3
        );
        assert_eq!(fields("struct A(u8, u8); struct B { a: u8 }"), 0);
        let uses = |text: &str| definitions(&tree(text)).last().map(|item| item.struct_use);
        assert_eq!(uses("#[derive(Debug, clap::Args)] #[x] pub(super) struct A;"), Some(StructUse::Options));
        assert_eq!(uses("#[derive(Serialize)] struct A;"), Some(StructUse::FileFormat));
        assert_eq!(
            uses("#[derive(Serialize)] struct B {} #[derive(Debug)] struct A;"),
            Some(StructUse::Inside)
        );
        assert_eq!(uses("#[derive(Debug)] #[serde(Serialize)] struct A;"), Some(StructUse::Inside));
    }

    #[test]
    fn visibilities_are_counted_apart() {
        let tree =
            tree("pub fn a() {}\npub(super) fn b() {}\npub(in x::y) fn c() {}\nstruct D(pub (u8, u8));\n");
        assert_eq!((plain_pub(&tree), restricted_pub(&tree)), (500.0, 500.0));
    }

    #[test]
    fn tests_are_counted_where_they_stand() {
        let text = "#[cfg(test)] mod tests { #[test] fn a() {} #[test] fn b() {} }";
        let tree = SourceTree::from_texts([
            ("crates/x/src/a.rs", text.to_owned()),
            ("tests/suite/b/c.rs", "#[test] fn c() {}".to_owned()),
        ]);
        assert_eq!(tests_beside_code(&tree), 2.0);
        let expected = [("crates/x/src".to_owned(), 2), ("tests/suite".to_owned(), 1)];
        assert_eq!(tests_by_directory(&tree), BTreeMap::from(expected));
    }
}

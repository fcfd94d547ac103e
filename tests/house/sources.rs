//! The sources of a tree, with product code and test code apart.

use std::fs;
use std::path::Path;

use crate::lexer::{Token, tokens};

/// A source of the product: the code that is built into a library or program, and the tests beside it.
pub(crate) struct SourceFile {
    /// Below the top of the tree, with `/`.
    pub(crate) path: String,
    pub(crate) product: Vec<Token>,
    pub(crate) tests: Vec<Token>,
    pub(crate) product_lines: usize,
    pub(crate) test_lines: usize,
}

/// A source that belongs to no `src` of a crate: suites, benches, fuzz targets, the Python package.
pub(crate) struct OtherFile {
    pub(crate) path: String,
    pub(crate) tokens: Vec<Token>,
}

pub(crate) struct SourceTree {
    /// What stands in `src` and `crates/*/src`, by path.
    pub(crate) files: Vec<SourceFile>,
    pub(crate) others: Vec<OtherFile>,
}

impl SourceTree {
    /// Reads every `.rs` file that is neither hidden nor a product of the build.
    pub(crate) fn read(top: &Path) -> Self {
        let mut paths = Vec::new();
        rust_files(top, "", &mut paths);
        paths.sort();
        let read = |path: &str| fs::read_to_string(top.join(path)).expect("a source is text");
        Self::from_texts(paths.iter().map(|path| (path.as_str(), read(path))))
    }

    /// From pairs of path and text.
    pub(crate) fn from_texts<'p>(texts: impl IntoIterator<Item = (&'p str, String)>) -> Self {
        let (mut files, mut others) = (Vec::new(), Vec::new());
        for (path, text) in texts {
            match crate_and_place(path) {
                Some((_, place)) => files.push(source_file(path, place, &text)),
                None => others.push(OtherFile { path: path.to_owned(), tokens: tokens(&text) }),
            }
        }
        Self { files, others }
    }
}

impl SourceFile {
    /// The `src` of its crate, and its place below that.
    pub(crate) fn crate_and_place(&self) -> (&str, &str) {
        crate_and_place(&self.path).expect("a source file is in a crate")
    }
}

/// `src` or `crates/NAME/src`, and the path below it.
fn crate_and_place(path: &str) -> Option<(&str, &str)> {
    let src = if path.starts_with("crates/") { path.find("/src/")? + 1 } else { 0 };
    let place = path[src..].strip_prefix("src/")?;
    Some((&path[..src + "src".len()], place))
}

fn rust_files(top: &Path, below: &str, found: &mut Vec<String>) {
    for entry in fs::read_dir(top.join(below)).expect("a directory can be read") {
        let entry = entry.expect("a directory can be read");
        let name = entry.file_name().to_string_lossy().into_owned();
        let path = if below.is_empty() { name.clone() } else { format!("{below}/{name}") };
        let kind = entry.file_type().expect("an entry has a type");
        if kind.is_dir() && !name.starts_with('.') && name != "target" {
            rust_files(top, &path, found);
        } else if kind.is_file() && name.ends_with(".rs") {
            found.push(path);
        }
    }
}

fn source_file(path: &str, place: &str, text: &str) -> SourceFile {
    let lines = text.lines().count();
    let all = tokens(text);
    let is_test = place.split('/').any(|part| ["tests", "tests.rs", "test_support"].contains(&part));
    let spans = if is_test { vec![(0, all.len())] } else { test_items(&all) };
    let test_lines = if is_test {
        lines
    } else {
        spans.iter().map(|(start, end)| all[end - 1].last_line - all[*start].line + 1).sum()
    };
    let (mut product, mut tests) = (Vec::new(), Vec::new());
    for (i, token) in all.into_iter().enumerate() {
        let is_test = spans.iter().any(|(start, end)| (*start..*end).contains(&i));
        if is_test { tests.push(token) } else { product.push(token) }
    }
    SourceFile { path: path.to_owned(), product, tests, product_lines: lines - test_lines, test_lines }
}

/// The ranges of tokens of the items under `#[cfg(test)]`.
fn test_items(all: &[Token]) -> Vec<(usize, usize)> {
    let attribute = ["#", "[", "cfg", "(", "test", ")", "]"];
    let mut found = Vec::new();
    let mut at = 0;
    while at < all.len() {
        if starts_with(&all[at..], &attribute) {
            let end = item_end(all, at + attribute.len());
            found.push((at, end));
            at = end;
        } else {
            at += 1;
        }
    }
    found
}

pub(crate) fn starts_with(tokens: &[Token], texts: &[&str]) -> bool {
    tokens.len() >= texts.len() && tokens.iter().zip(texts).all(|(token, text)| token.is(text))
}

/// Behind the `;` or the block that ends the item from `start` on.
fn item_end(all: &[Token], start: usize) -> usize {
    let mut at = start;
    let mut is_import = false;
    while at < all.len() {
        match all[at].text.as_str() {
            ";" => return at + 1,
            "{" if !is_import => return closing(all, at) + 1,
            "{" | "(" | "[" => at = closing(all, at),
            "use" => is_import = true,
            _ => {}
        }
        at += 1;
    }
    all.len()
}

/// The index of the bracket that closes the one at `open`; the last token if none does.
pub(crate) fn closing(all: &[Token], open: usize) -> usize {
    let mut depth = 0_usize;
    for (at, token) in all.iter().enumerate().skip(open) {
        match token.text.as_str() {
            "{" | "(" | "[" => depth += 1,
            "}" | ")" | "]" => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            return at;
        }
    }
    all.len() - 1
}

#[cfg(test)]
mod tests {
    use super::{SourceTree, crate_and_place};

    #[test]
    fn test_code_is_apart() {
        let text = "use a::b;\nfn f() {}\n#[cfg(test)]\nuse c::{d, e};\n#[cfg(test)]\nmod tests {\n    fn g() { '}'; }\n}\n";
        let tree = SourceTree::from_texts([("src/a.rs", text.to_owned()), ("tests/b.rs", text.to_owned())]);
        let file = &tree.files[0];
        assert_eq!((file.product_lines, file.test_lines), (2, 6));
        assert!(file.product.iter().all(|token| !token.is("e") && !token.is("g")));
        assert!(file.tests.iter().any(|token| token.is("g")));
        assert_eq!(tree.others.len(), 1);
    }

    #[test]
    fn crates_are_told_apart_by_their_src() {
        assert_eq!(crate_and_place("src/a/b.rs"), Some(("src", "a/b.rs")));
        assert_eq!(crate_and_place("crates/x/src/b.rs"), Some(("crates/x/src", "b.rs")));
        assert_eq!(crate_and_place("python/src/lib.rs"), None);
        assert_eq!(crate_and_place("crates/x/tests/b.rs"), None);
    }
}

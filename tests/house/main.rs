//! The figures of the sources and their limits: whether names can be searched, interfaces read and parts tested alone.
//!
//! `cargo test --test house -- --nocapture figures` prints them. `DBBD_HOUSE_TREE` names another tree to measure.
// A test asks for the variant that it means.
#![allow(clippy::wildcard_enum_match_arm)]
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod figures;
mod imports;
mod lexer;
mod sources;

use std::env;
use std::fmt::{self, Write as _};
use std::path::PathBuf;

use figures::StructUse;
use imports::ChildImports;
use sources::SourceTree;

type Measure = fn(&SourceTree) -> f64;

/// What is counted without a limit.
const COUNTS: &[(&str, Measure)] = &[
    ("lines of product code", figures::product_lines),
    ("files with product code", figures::product_files),
    ("lines of test code beside it", figures::test_lines),
    ("types", figures::types),
    ("names of types", figures::type_names),
    ("wide structs: options of a command", figures::wide_option_structs),
    ("wide structs: file formats", figures::wide_format_structs),
];

/// The value that each figure may have and why. Whoever makes a figure better moves its limit with it; none moves back.
const LIMITS: &[Limit] = &[
    Limit {
        figure: "types that share their name, %",
        measure: figures::shared_names,
        allowed: AtMost(8.1),
        reason: "a search for a name should find one type",
    },
    Limit {
        figure: "types with a name of one word, %",
        measure: figures::one_word_names,
        allowed: AtMost(28.1),
        reason: "a name should say its subject: `JointFitSolution`, not `Solution`",
    },
    Limit {
        figure: "`pub(super)`, `pub(crate)`, `pub(in ..)` per 1000 lines",
        measure: figures::restricted_pub,
        allowed: AtMost(23.9),
        reason: "private fields behind methods need no visibility",
    },
    Limit {
        figure: "plain `pub` per 1000 lines",
        measure: figures::plain_pub,
        allowed: AtMost(43.4),
        reason: "every public name is one more for the reader of the interface",
    },
    Limit {
        figure: "wide structs: neither options nor file formats",
        measure: figures::wide_structs,
        allowed: AtMost(5.0),
        reason: "a struct that holds everything hides which function needs what",
    },
    Limit {
        figure: "circles of files",
        measure: figures::import_circles,
        allowed: AtMost(13.0),
        reason: "the files of a circle can only be read and changed together",
    },
    Limit {
        figure: "files in circles",
        measure: figures::files_in_circles,
        allowed: AtMost(75.0),
        reason: "the files of a circle can only be read and changed together",
    },
    Limit {
        figure: "files of the largest circle",
        measure: figures::largest_circle,
        allowed: AtMost(41.0),
        reason: "the files of a circle can only be read and changed together",
    },
    Limit {
        figure: "circles without a parent's imports from its children",
        measure: figures::import_knots,
        allowed: AtMost(0.0),
        reason: "siblings in a circle have no first one to read",
    },
    Limit {
        figure: "files in circles without a parent's imports from its children",
        measure: figures::files_in_knots,
        allowed: AtMost(0.0),
        reason: "siblings in a circle have no first one to read",
    },
    Limit {
        figure: "`#[test]` beside the code",
        measure: figures::tests_beside_code,
        allowed: AtLeast(1060.0),
        reason: "what can be shown without the program is shown in the module that does it",
    },
];

struct Limit {
    figure: &'static str,
    measure: Measure,
    allowed: Allowed,
    reason: &'static str,
}

#[derive(Clone, Copy)]
enum Allowed {
    AtMost(f64),
    AtLeast(f64),
}
use Allowed::{AtLeast, AtMost};

impl Allowed {
    fn holds(self, value: f64) -> bool {
        match self {
            AtMost(most) => value <= most,
            AtLeast(least) => value >= least,
        }
    }
}

impl fmt::Display for Allowed {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            AtMost(most) => write!(out, "at most {most}"),
            AtLeast(least) => write!(out, "at least {least}"),
        }
    }
}

fn measured_tree() -> SourceTree {
    // Without Cargo the tree is where the program is started.
    let own = option_env!("CARGO_MANIFEST_DIR").unwrap_or(".");
    SourceTree::read(&env::var_os("DBBD_HOUSE_TREE").map_or_else(|| PathBuf::from(own), PathBuf::from))
}

/// A figure as it is printed and compared: with at most one decimal.
fn rounded(value: f64) -> f64 {
    (10.0 * value).round() / 10.0
}

fn report(tree: &SourceTree) -> Result<String, fmt::Error> {
    let mut out = String::from("\n| figure | value | allowed |\n|---|---:|---|\n");
    for (figure, measure) in COUNTS {
        writeln!(out, "| {figure} | {} | |", rounded(measure(tree)))?;
    }
    for Limit { figure, measure, allowed, .. } in LIMITS {
        writeln!(out, "| {figure} | {} | {allowed} |", rounded(measure(tree)))?;
    }
    out.push_str("\n| directory | `#[test]` |\n|---|---:|\n");
    for (directory, tests) in figures::tests_by_directory(tree) {
        writeln!(out, "| {directory} | {tests} |")?;
    }
    for (title, wanted) in [
        ("neither options nor a file format", StructUse::Inside),
        ("options of a command", StructUse::Options),
        ("file formats", StructUse::FileFormat),
    ] {
        writeln!(out, "\nStructs with {} fields or more, {title}:", figures::MANY_FIELDS)?;
        for item in figures::wide(tree, wanted) {
            writeln!(out, "- `{}` {}, {}", item.name, item.named_fields, item.path)?;
        }
    }
    for (title, child_imports) in [
        ("Circles of files", ChildImports::Count),
        ("Circles without a parent's imports from its children", ChildImports::Ignore),
    ] {
        writeln!(out, "\n{title}:")?;
        for group in imports::circles(tree, child_imports) {
            writeln!(out, "- {}: {}", group.len(), group.join(" "))?;
        }
    }
    Ok(out)
}

#[test]
fn figures_are_printed() {
    println!("{}", report(&measured_tree()).expect("a string can be written"));
}

#[test]
fn limits_hold() {
    let tree = measured_tree();
    let mut broken = Vec::new();
    for Limit { figure, measure, allowed, reason } in LIMITS {
        let value = rounded(measure(&tree));
        if !allowed.holds(value) {
            broken.push(format!("{figure}: {value}, but {allowed} is allowed: {reason}"));
        }
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

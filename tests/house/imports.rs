//! Which file of a crate imports which, and the circles of files that this makes.
//!
//! A file imports the file in which a name of its code is defined, whatever re-exports lie between. `mod child;` and a
//! re-export are no imports: they show a name and do not use it.

use std::collections::{BTreeMap, BTreeSet};

use crate::lexer::Token;
use crate::sources::{SourceFile, SourceTree, closing};

/// Whether a file's imports from the files of its own child modules count.
///
/// A parent that puts its children together, while they use what it defines, is common; a circle without that is a knot.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum ChildImports {
    Count,
    Ignore,
}

/// Groups of files of one crate of which each reaches each other by imports; the largest first.
pub(crate) fn circles(tree: &SourceTree, child_imports: ChildImports) -> Vec<Vec<&str>> {
    let mut by_crate: BTreeMap<&str, Vec<&SourceFile>> = BTreeMap::new();
    for file in &tree.files {
        let (source, place) = file.crate_and_place();
        // A program's `main.rs` is a crate of its own.
        if place != "main.rs" && !place.starts_with("bin/") {
            by_crate.entry(source).or_default().push(file);
        }
    }
    let mut found = Vec::new();
    for files in by_crate.values() {
        let mut edges = imports(files);
        if child_imports == ChildImports::Ignore {
            for (from, imports) in edges.iter_mut().enumerate() {
                imports.retain(|to| !is_below(files[*to], files[from]));
            }
        }
        let named = |group: Vec<usize>| group.into_iter().map(|file| files[file].path.as_str()).collect();
        found.extend(strong_components(&edges).into_iter().filter(|group| group.len() > 1).map(named));
    }
    found.sort_by_key(|group: &Vec<&str>| (usize::MAX - group.len(), group[0]));
    found
}

/// Whether a file holds a module inside that of `parent`.
fn is_below(file: &SourceFile, parent: &SourceFile) -> bool {
    let own = |file: &SourceFile| -> Vec<String> {
        module_names(file.crate_and_place().1).map(str::to_owned).collect()
    };
    let (inner, outer) = (own(file), own(parent));
    inner.len() > outer.len() && inner.starts_with(&outer)
}

/// The names of the modules from the root of a crate to that of a file.
fn module_names(place: &str) -> impl Iterator<Item = &str> {
    place.trim_end_matches(".rs").split('/').filter(|name| !["lib", "mod"].contains(name))
}

/// A module: a file, or a block in one.
struct Module {
    file: usize,
    parent: usize,
    children: BTreeMap<String, usize>,
    /// Names of items defined here.
    items: BTreeSet<String>,
    imports: Vec<Import>,
    /// Paths and single names in the code.
    mentions: Vec<Vec<String>>,
}

/// One name that `use` brings into a module.
struct Import {
    /// `*` for all names.
    name: String,
    path: Vec<String>,
    is_re_export: bool,
}

/// The modules of a crate; the first is its root.
struct ModuleTree {
    modules: Vec<Module>,
}

/// What a path leads to.
#[derive(Clone, Copy)]
enum Target {
    Module(usize),
    /// An item of the module.
    Item(usize),
}

/// For each file the files that it imports.
fn imports(files: &[&SourceFile]) -> Vec<BTreeSet<usize>> {
    let mut tree = ModuleTree { modules: vec![Module::new(usize::MAX, 0)] };
    for (file, source) in files.iter().enumerate() {
        let module = tree.module_of_file(source.crate_and_place().1, file);
        tree.read(&source.product, module);
    }
    let mut found = vec![BTreeSet::new(); files.len()];
    for (at, module) in tree.modules.iter().enumerate() {
        let used = module.imports.iter().filter(|import| !import.is_re_export).map(|import| &import.path);
        for path in used.chain(&module.mentions) {
            let (Some(Target::Module(of) | Target::Item(of)), Some(imports)) =
                (tree.resolve(at, path, 0), found.get_mut(module.file))
            else {
                continue;
            };
            let to = tree.modules[of].file;
            if to != module.file && to < files.len() {
                imports.insert(to);
            }
        }
    }
    found
}

impl Module {
    fn new(file: usize, parent: usize) -> Self {
        Self {
            file,
            parent,
            children: BTreeMap::new(),
            items: BTreeSet::new(),
            imports: Vec::new(),
            mentions: Vec::new(),
        }
    }
}

impl ModuleTree {
    fn module_of_file(&mut self, place: &str, file: usize) -> usize {
        let module = module_names(place).fold(0, |parent, name| self.child(parent, name, usize::MAX));
        self.modules[module].file = file;
        module
    }

    /// The child of this name, made if it is not there.
    fn child(&mut self, parent: usize, name: &str, file: usize) -> usize {
        if let Some(child) = self.modules[parent].children.get(name) {
            return *child;
        }
        self.modules.push(Module::new(file, parent));
        let child = self.modules.len() - 1;
        self.modules[parent].children.insert(name.to_owned(), child);
        child
    }

    /// Reads the items, imports and paths of a module from its tokens.
    fn read(&mut self, tokens: &[Token], module: usize) {
        let mut depth = 0_usize;
        let mut at = 0;
        while at < tokens.len() {
            let word = tokens[at].text.as_str();
            let next = tokens.get(at + 1).filter(|next| next.is_word());
            match (word, next) {
                ("{", _) => depth += 1,
                ("}", _) => depth -= 1,
                ("mod", Some(name)) if tokens.get(at + 2).is_some_and(|sign| sign.is("{")) => {
                    let child = self.child(module, &name.text, self.modules[module].file);
                    let end = closing(tokens, at + 2);
                    self.read(&tokens[at + 3..end], child);
                    at = end;
                }
                // `use<'a>` is a bound, no import.
                ("use", _) if !tokens.get(at + 1).is_some_and(|sign| sign.is("<")) => {
                    let end = at + tokens[at..].iter().position(|token| token.is(";")).unwrap_or(0);
                    let is_re_export =
                        at > 0 && depth == 0 && (tokens[at - 1].is("pub") || tokens[at - 1].is(")"));
                    import_tree(&tokens[at + 1..end], &[], is_re_export, &mut self.modules[module].imports);
                    at = end;
                }
                ("struct" | "enum" | "trait" | "type" | "union" | "fn" | "const" | "static", Some(name))
                    if !name.is("fn") =>
                {
                    if depth == 0 {
                        self.modules[module].items.insert(name.text.clone());
                    }
                    at += 1;
                }
                _ if tokens[at].is_word() => at += self.mention(&tokens[at..], module),
                // A field, a method or the rest of a path behind its generics names nothing here.
                ("." | "::", Some(_)) => at += 1,
                _ => {}
            }
            at += 1;
        }
    }

    /// Notes the path that begins here; the number of tokens behind its first.
    fn mention(&mut self, tokens: &[Token], module: usize) -> usize {
        let mut path = vec![tokens[0].text.clone()];
        for pair in tokens[1..].chunks_exact(2).take_while(|pair| pair[0].is("::") && pair[1].is_word()) {
            path.push(pair[1].text.clone());
        }
        let behind = 2 * (path.len() - 1);
        // A single name in lower case is a variable or a field unless it is called.
        let is_called = tokens.get(1).is_some_and(|next| next.is("("));
        if path.len() > 1 || is_called || path[0].starts_with(char::is_uppercase) {
            self.modules[module].mentions.push(path);
        }
        behind
    }

    /// Where a path leads that is written in a module; `None` outside the crate.
    fn resolve(&self, module: usize, path: &[String], depth: usize) -> Option<Target> {
        // Globs may lead in a circle.
        if depth > 16 {
            return None;
        }
        let (first, rest) = path.split_first()?;
        let mut target = match first.as_str() {
            "crate" => Target::Module(0),
            "self" => Target::Module(module),
            "super" => Target::Module(self.modules[module].parent),
            name => self.lookup(module, name, depth)?,
        };
        for name in rest {
            let Target::Module(inside) = target else { break };
            target = match name.as_str() {
                "self" | "*" => target,
                "super" => Target::Module(self.modules[inside].parent),
                // What a macro defines is not seen, and belongs to its module.
                name => self.lookup(inside, name, depth).unwrap_or(Target::Item(inside)),
            };
        }
        Some(target)
    }

    /// A name in a module: a child, an item, or what an import brings.
    fn lookup(&self, module: usize, name: &str, depth: usize) -> Option<Target> {
        let Module { children, items, imports, .. } = &self.modules[module];
        if let Some(child) = children.get(name) {
            return Some(Target::Module(*child));
        }
        if items.contains(name) {
            return Some(Target::Item(module));
        }
        if let Some(import) = imports.iter().find(|import| import.name == name) {
            // `use name::other` with an external crate of this name would look itself up.
            return (import.path[0] != name).then(|| self.resolve(module, &import.path, depth + 1))?;
        }
        let globs = imports.iter().filter(|import| import.name == "*" && import.path[0] != name);
        globs.into_iter().find_map(|import| match self.resolve(module, &import.path, depth + 1)? {
            Target::Module(inside) if inside != module => self.lookup(inside, name, depth + 1),
            _ => None,
        })
    }
}

/// The leaves of a `use` tree below `prefix`.
fn import_tree(tokens: &[Token], prefix: &[String], is_re_export: bool, found: &mut Vec<Import>) {
    let mut path = prefix.to_vec();
    let mut alias = None;
    let mut at = 0;
    while at < tokens.len() {
        match tokens[at].text.as_str() {
            "::" => {}
            "{" => {
                let end = closing(tokens, at);
                for branch in split_at_commas(&tokens[at + 1..end]) {
                    import_tree(branch, &path, is_re_export, found);
                }
                return;
            }
            "as" => {
                alias = tokens.get(at + 1).map(|token| token.text.clone());
                break;
            }
            name => path.push(name.to_owned()),
        }
        at += 1;
    }
    let own_name = path.iter().rev().find(|name| *name != "self");
    if let Some(name) = alias.or_else(|| own_name.cloned()) {
        found.push(Import { name, path, is_re_export });
    }
}

fn split_at_commas(tokens: &[Token]) -> Vec<&[Token]> {
    let mut parts = Vec::new();
    let (mut start, mut at) = (0, 0);
    while at < tokens.len() {
        if tokens[at].is("{") {
            at = closing(tokens, at);
        } else if tokens[at].is(",") {
            parts.push(&tokens[start..at]);
            start = at + 1;
        }
        at += 1;
    }
    parts.push(&tokens[start..]);
    parts
}

/// The strongly connected components of a graph (Tarjan, SIAM Journal on Computing 1, 1972).
fn strong_components(edges: &[BTreeSet<usize>]) -> Vec<Vec<usize>> {
    let mut search = ComponentSearch {
        edges,
        order: vec![None; edges.len()],
        lowest: vec![0; edges.len()],
        open: Vec::new(),
        visited: 0,
        found: Vec::new(),
    };
    for node in 0..edges.len() {
        if search.order[node].is_none() {
            search.visit(node);
        }
    }
    search.found
}

struct ComponentSearch<'e> {
    edges: &'e [BTreeSet<usize>],
    /// When each node was visited.
    order: Vec<Option<usize>>,
    /// The earliest open node that each reaches.
    lowest: Vec<usize>,
    /// Visited nodes whose component is not complete.
    open: Vec<usize>,
    visited: usize,
    found: Vec<Vec<usize>>,
}

impl ComponentSearch<'_> {
    fn visit(&mut self, node: usize) {
        let own = self.visited;
        self.visited += 1;
        self.order[node] = Some(own);
        self.lowest[node] = own;
        self.open.push(node);
        let edges = self.edges;
        for next in &edges[node] {
            match self.order[*next] {
                None => {
                    self.visit(*next);
                    self.lowest[node] = self.lowest[node].min(self.lowest[*next]);
                }
                Some(order) if self.open.contains(next) => self.lowest[node] = self.lowest[node].min(order),
                Some(_) => {}
            }
        }
        if self.lowest[node] == own {
            let start = self.open.iter().position(|open| *open == node).unwrap_or(0);
            let mut component = self.open.split_off(start);
            component.sort_unstable();
            self.found.push(component);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{ChildImports, circles};
    use crate::sources::SourceTree;

    fn circles_of(texts: &[(&str, &str)]) -> Vec<String> {
        let tree = SourceTree::from_texts(texts.iter().map(|(path, text)| (*path, (*text).to_owned())));
        circles(&tree, ChildImports::Count).iter().map(|group| group.join(" ")).collect()
    }

    #[test]
    fn import_is_followed_through_re_exports() {
        let parent = ("src/m/mod.rs", "mod a; mod b; pub use a::A; pub(crate) use b::B;");
        let a = ("src/m/a.rs", "use super::B; pub struct A; fn f(b: B) {}");
        let b = ("src/m/b.rs", "pub struct B; fn g(a: &crate::m::A) {}");
        assert_eq!(circles_of(&[("src/lib.rs", "mod m;"), a, b, parent]), ["src/m/a.rs src/m/b.rs"]);
        let uses_none = ("src/m/b.rs", "pub struct B; fn g() { x.A() }");
        assert!(circles_of(&[("src/lib.rs", "mod m;"), a, uses_none, parent]).is_empty());
    }

    #[test]
    fn parent_is_in_the_circle_if_it_uses_what_it_shows() {
        let child = ("src/m/a.rs", "use super::Size; pub struct A(Size);");
        let shows = ("src/m/mod.rs", "mod a; pub use a::A; pub struct Size;");
        assert!(circles_of(&[child, shows]).is_empty());
        for uses in ["pub use a::A; fn f(a: A) {}", "use a::A;", "fn f() { a::g() }", "use self::a::*;"] {
            let text = format!("mod a; pub struct Size; {uses}");
            assert_eq!(circles_of(&[child, ("src/m/mod.rs", &text)]), ["src/m/a.rs src/m/mod.rs"], "{uses}");
            let tree = SourceTree::from_texts([(child.0, child.1.to_owned()), ("src/m/mod.rs", text)]);
            assert!(circles(&tree, ChildImports::Ignore).is_empty(), "{uses}");
        }
    }

    #[test]
    fn blocks_globs_and_aliases_are_followed() {
        let root = ("src/lib.rs", "mod a; mod b; mod c;");
        let a = (
            "src/a.rs",
            "mod column { use crate::{b::{self as other}}; fn f() -> other::B {} } pub struct A;",
        );
        let b = ("src/b.rs", "use super::c::*; pub struct B; fn f() -> Far {}");
        let c = ("src/c.rs", "pub use crate::a::A as Far;");
        assert_eq!(circles_of(&[root, a, b, c]), ["src/a.rs src/b.rs"]);
    }

    #[test]
    fn tests_other_crates_and_one_way_make_no_circle() {
        let b = "use crate::a::A; pub struct B; #[cfg(test)] mod tests { use crate::a::A; }";
        let a = "pub struct A; #[cfg(test)] mod tests { use crate::b::B; }";
        assert!(circles_of(&[("src/a.rs", a), ("src/b.rs", b)]).is_empty());
        let c = "use crate::a::A; use std::a::B;";
        assert!(
            circles_of(&[("crates/x/src/b.rs", c), ("src/a.rs", "use crate::b::B; pub struct A;")])
                .is_empty()
        );
    }
}

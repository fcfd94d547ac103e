//! A program: a module and all that it calls, each a `.src` with its `.dat`.

use super::parser::{parse_data, parse_source};
use super::syntax::{Block, Data, Routine, Source, Span, Statement, StatementKind};
use crate::diag::Diagnostic;

/// Routines of the controller itself that a program may call.
pub const BUILT_IN: &[&str] = &["BAS", "IR_STOPM"];

/// A module.
#[derive(Clone, Debug)]
pub struct Module {
    /// Name in capitals.
    pub name: String,
    /// Its code.
    pub source: Source,
    /// Its data, if it has any.
    pub data: Option<Data>,
}

/// A module and all that it calls; the first is where execution begins.
#[derive(Clone, Debug)]
pub struct Program {
    /// The modules in the order in which they are first called.
    pub modules: Vec<Module>,
}

impl Program {
    /// Reads the module `name` and every module that is called from it. `file` gives the name and the
    /// text of `NAME.src` or `NAME.dat` (case does not matter), or `None` where there is no such file.
    ///
    /// # Errors
    /// What `file` says, what is not understood in a file, a name that does not match its file's, a
    /// call of a routine that is nowhere.
    pub fn open(
        name: &str,
        mut file: impl FnMut(&str) -> Result<Option<(String, String)>, Diagnostic>,
    ) -> Result<Self, Diagnostic> {
        let mut modules: Vec<Module> = Vec::new();
        let mut wanted: Vec<(String, Option<Diagnostic>)> = vec![(name.to_ascii_uppercase(), None)];
        let mut at = 0;
        while let Some((name, caller)) = wanted.get(at).cloned() {
            at += 1;
            let Some((source_name, text)) = file(&format!("{name}.src"))? else {
                let nowhere = Diagnostic::file(&format!("{name}.src"), "there is no such file");
                return Err(caller.unwrap_or(nowhere));
            };
            let source = parse_source(&source_name, &text)?;
            if let Some(first) = source.routines.first().filter(|first| first.name != name) {
                let message = format!("DEF {} stands in a file named {name}", first.name);
                return Err(Diagnostic::span(&source.file, &source.text, first.span.clone(), message)
                    .help("give the file and its first routine the same name"));
            }
            let data = match file(&format!("{name}.dat"))? {
                None => None,
                Some((data_name, text)) => Some(parse_data(&data_name, &text)?),
            };
            if let Some(data) = data.as_ref().filter(|data| data.name != name) {
                let message = format!("DEFDAT {} does not belong to {name}.src", data.name);
                return Err(Diagnostic::file(&data.file, message));
            }
            for routine in &source.routines {
                for (span, called) in calls(&routine.body) {
                    let local = source.routines.iter().any(|other| other.name == called);
                    if !local && !BUILT_IN.contains(&called) && !wanted.iter().any(|(name, _)| name == called)
                    {
                        let message =
                            format!("{called} is called, and there is no {called}.src beside this file");
                        let missing = Diagnostic::span(&source.file, &source.text, span, message)
                            .help("define it in this file or put its module beside it");
                        wanted.push((called.to_owned(), Some(missing)));
                    }
                }
            }
            modules.push(Module { name, source, data });
        }
        Ok(Self { modules })
    }

    /// The routine that `name` means inside `module`: a local one, else another module's first.
    pub fn routine(&self, module: usize, name: &str) -> Option<(usize, &Routine)> {
        let local = |at: usize| self.modules.get(at).map(|module| &module.source.routines);
        if let Some(routine) = local(module)?.iter().find(|routine| routine.name == name) {
            return Some((module, routine));
        }
        let at = self.modules.iter().position(|module| module.name == name)?;
        Some((at, local(at)?.first()?))
    }
}

/// Every call in a block and in those inside it: its place and the name called.
fn calls(block: &Block) -> Vec<(Span, &str)> {
    let mut found = Vec::new();
    let mut open: Vec<&Statement> = block.iter().collect();
    while let Some(statement) = open.pop() {
        match &statement.kind {
            StatementKind::Call { name, .. } => found.push((statement.span.clone(), name.as_str())),
            StatementKind::For { body, .. }
            | StatementKind::While { body, .. }
            | StatementKind::Loop(body) => {
                open.extend(body.iter());
            }
            StatementKind::If { then, otherwise, .. } => open.extend(then.iter().chain(otherwise.iter())),
            _ => {}
        }
    }
    found.sort_by_key(|(span, _)| span.start);
    found
}

//! A program: a module and all that it calls, each a `.src` with its `.dat`.

use super::data::read_setup;
use super::parser::{parse_data, parse_source};
use super::syntax::{Block, Data, Routine, Source, Span, StatementKind};
use crate::catalogue::ProgramFinding;
use crate::diagnostic::Diagnostic;
use crate::program::{Equipped, Setup};

/// Routines of the controller itself that a program may call.
pub const BUILT_IN: &[&str] = &["BAS", "IR_STOPM"];

#[derive(Clone, Debug)]
pub struct Module {
    /// In capitals.
    pub name: String,
    pub source: Source,
    pub data: Option<Data>,
}

/// A module and all that it calls; the first is where execution begins.
#[derive(Clone, Debug)]
pub struct Program {
    /// In the order in which they are first called.
    pub modules: Vec<Module>,
}

/// A module that is to be read, and what is wrong where it is called if there is none.
#[derive(Clone)]
struct Wanted {
    name: String,
    missing: Diagnostic,
}

impl Program {
    /// Reads the module `name` and every module that is called from it. `file` gives the name and the text of `NAME.src`
    /// or `NAME.dat` (case does not matter), or `None` where there is no such file.
    pub fn open(
        name: &str,
        mut file: impl FnMut(&str) -> Result<Option<(String, String)>, Diagnostic>,
    ) -> Result<Self, Diagnostic> {
        let name = name.to_ascii_uppercase();
        let missing = Diagnostic::file(&format!("{name}.src"), ProgramFinding::NoModuleFile);
        let mut wanted = vec![Wanted { name, missing }];
        let mut modules: Vec<Module> = Vec::new();
        while let Some(Wanted { name, missing }) = wanted.get(modules.len()).cloned() {
            let Some((source_name, text)) = file(&format!("{name}.src"))? else {
                return Err(missing);
            };
            let source = parse_source(&source_name, &text)?;
            let data = match file(&format!("{name}.dat"))? {
                None => None,
                Some((data_name, text)) => Some(parse_data(&data_name, &text)?),
            };
            let module = Module { name, source, data };
            module.check_names()?;
            for (span, called) in module.calls_elsewhere() {
                if !wanted.iter().any(|wanted| wanted.name == called) {
                    let nowhere = ProgramFinding::NoSuchRoutine { name: called.into() };
                    let missing = module.source.as_text().wrong(&span, nowhere);
                    wanted.push(Wanted { name: called.into(), missing });
                }
            }
            modules.push(module);
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

impl Equipped for Program {
    fn setups(&self) -> Vec<Setup> {
        self.modules.iter().filter_map(|module| read_setup(module.data.as_ref()?)).collect()
    }
}

impl Module {
    /// Refuses names that differ from the file's.
    fn check_names(&self) -> Result<(), Diagnostic> {
        let file = &self.name;
        if let Some(first) = self.source.routines.first().filter(|first| first.name != *file) {
            let other = ProgramFinding::OtherModuleName { routine: first.name.clone(), file: file.clone() };
            return Err(self.source.as_text().wrong(&first.span, other));
        }
        match self.data.as_ref().filter(|data| data.name != *file) {
            Some(data) => {
                let other = ProgramFinding::OtherDataName { data: data.name.clone(), module: file.clone() };
                Err(Diagnostic::file(&data.file, other))
            }
            None => Ok(()),
        }
    }

    /// The calls of routines that are neither in this module nor the controller's own.
    fn calls_elsewhere(&self) -> Vec<(Span, &str)> {
        let mut found: Vec<(Span, &str)> =
            self.source.routines.iter().flat_map(|routine| calls(&routine.body)).collect();
        found.retain(|(_, called)| {
            !BUILT_IN.contains(called) && !self.source.routines.iter().any(|other| other.name == *called)
        });
        found
    }
}

/// Every call in a block and in those inside it.
fn calls(block: &Block) -> Vec<(Span, &str)> {
    let mut found = Vec::new();
    let mut open = vec![block];
    while let Some(block) = open.pop() {
        for statement in block.iter() {
            if let StatementKind::Call { name, .. } = &statement.kind {
                found.push((statement.span.clone(), name.as_str()));
            }
            open.extend(statement.kind.blocks());
        }
    }
    found.sort_by_key(|(span, _)| span.start);
    found
}

//! A whole program: a module and the modules that it calls, each a `.src` with its `.dat`.

use super::data::read_setup;
use super::parser::{parse_data, parse_source};
use super::syntax::{Block, Data, DataItem, Declaration, Routine, Source, Span, StatementKind};
use crate::program::ProgramFinding;
use crate::program::{Setup, Text, check_one_plan};
use dbbd_model::diagnostic::Diagnostic;

/// Routines of the controller that a program may call.
pub const BUILT_IN: &[&str] = &["BAS", "IR_STOPM"];

#[derive(Clone, Debug)]
pub struct Module {
    /// Name of the module, in capitals.
    pub name: String,
    pub source: Source,
    pub data: Option<Data>,
}

/// A module and the modules that it calls; execution begins in the first.
#[derive(Clone, Debug)]
pub struct Program {
    /// The modules, in the order of their first call.
    pub modules: Vec<Module>,
}

/// A module to read, with the finding that its first call causes if the module does not exist.
#[derive(Clone)]
struct Wanted {
    name: String,
    missing: Diagnostic,
}

impl Program {
    /// Whether the program is one for KSS 5 (KR C2), where a module declares each routine of the system that it calls, `BAS` too.
    pub(crate) fn is_kss5(&self) -> bool {
        let items =
            self.modules.iter().filter_map(|module| module.data.as_ref()).flat_map(|data| &data.items);
        let mut declarations = items.filter_map(|item| match item {
            DataItem::Declaration(declaration) => Some(declaration),
            DataItem::Value { .. } => None,
        });
        declarations.any(|declaration| matches!(declaration, Declaration::External { name } if name == "BAS"))
    }

    /// Reads the module `name` and all modules that are called from it. `file` returns name and text of `NAME.src` or
    /// `NAME.dat`, whose case it ignores, or `None` if there is no such file.
    pub fn open(
        name: &str,
        mut file: impl FnMut(&str) -> Result<Option<(String, String)>, Diagnostic>,
    ) -> Result<Self, Diagnostic> {
        let name = name.to_ascii_uppercase();
        let missing = Diagnostic::file(format!("{name}.src"), ProgramFinding::NoModuleFile);
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
            module.check_files()?;
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

    /// The routine `name` as seen in `module`, with the index of its module: a local routine, else the first one in
    /// another module.
    pub fn routine(&self, module: usize, name: &str) -> Option<(usize, &Routine)> {
        let routines = |at: usize| self.modules.get(at).map(|module| &module.source.routines);
        if let Some(routine) = routines(module)?.iter().find(|routine| routine.name == name) {
            return Some((module, routine));
        }
        let at = self.modules.iter().position(|module| module.name == name)?;
        Some((at, routines(at)?.first()?))
    }

    /// The file in which execution begins.
    pub fn first(&self) -> Text<'_> {
        let first = self.modules.first();
        first.map_or(Text { file: "", text: "" }, |module| module.source.as_text())
    }

    /// The set-up of each module that has one.
    pub fn setups(&self) -> Vec<Setup> {
        self.modules.iter().filter_map(|module| read_setup(module.data.as_ref()?)).collect()
    }
}

impl Module {
    /// Refuses a routine or data list whose name differs from the file's, and data of another plan.
    fn check_files(&self) -> Result<(), Diagnostic> {
        let file = &self.name;
        if let Some(first) = self.source.routines.first().filter(|first| first.name != *file) {
            let other = ProgramFinding::OtherModuleName { routine: first.name.clone(), file: file.clone() };
            return Err(self.source.as_text().wrong(&first.span, other));
        }
        let Some(data) = &self.data else { return Ok(()) };
        if data.name != *file {
            let other = ProgramFinding::OtherDataName { data: data.name.clone(), module: file.clone() };
            return Err(Diagnostic::file(&data.file, other));
        }
        check_one_plan(self.source.as_text(), data.as_text())
    }

    /// The calls of routines that are neither in this module nor built in.
    fn calls_elsewhere(&self) -> Vec<(Span, &str)> {
        let routines = &self.source.routines;
        let calls = routines.iter().flat_map(|routine| calls(&routine.body));
        let is_elsewhere =
            |called: &str| !BUILT_IN.contains(&called) && !routines.iter().any(|other| other.name == called);
        calls.filter(|(_, called)| is_elsewhere(called)).collect()
    }
}

/// The calls in a block and in the blocks inside it, in the order of the text.
fn calls(block: &Block) -> Vec<(Span, &str)> {
    let mut calls = Vec::new();
    let mut blocks = vec![block];
    while let Some(block) = blocks.pop() {
        for statement in block.iter() {
            if let StatementKind::Call { name, .. } = &statement.kind {
                calls.push((statement.span.clone(), name.as_str()));
            }
            blocks.extend(statement.kind.blocks());
        }
    }
    calls.sort_by_key(|(span, _)| span.start);
    calls
}

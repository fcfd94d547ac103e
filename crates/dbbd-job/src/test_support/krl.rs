//! Emitted KRL, read back.

use dbbd_job::plan::MotionKind;
use dbbd_job::program::Target;
use dbbd_job::program::krl::{Files, Given, Module, Program, Text, read};

pub(crate) fn program(modules: &[(String, String)]) -> Program {
    Program::open("DBB_MAIN", |wanted| {
        let found = modules.iter().find(|(name, _)| name.eq_ignore_ascii_case(wanted));
        Ok(found.cloned())
    })
    .unwrap()
}

/// The motions of a module: auxiliary point, end, sweep in degrees.
pub(crate) fn motions(module: &Module) -> Vec<(MotionKind, Option<Target>, Target, Option<f64>)> {
    let data = module.data.as_ref().map(|data| Text { file: &data.file, text: &data.text });
    let source = Text { file: &module.source.file, text: &module.source.text };
    let program = read(Files { source, data, config: None }, Given::default()).unwrap();
    assert!(program.not_corrected.is_empty());
    let target = |points: &[usize]| match points {
        [] => None,
        [at] => Some(program.points[*at].target.clone()),
        more => panic!("{more:?}"),
    };
    let legs = program.motions.iter();
    legs.map(|leg| (leg.motion, target(&leg.through), target(&leg.to).unwrap(), leg.sweep_deg)).collect()
}

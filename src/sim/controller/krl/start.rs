//! A controller with a program selected: its variables declared and set as the `.dat` files say.

use std::collections::BTreeMap;

use super::execute::Level;
use super::store::{self, Names, Variable};
use super::{Activity, Interpreter, Signal};
use crate::catalogue::ProgramFinding;
use crate::diagnostic::Diagnostic;
use crate::program::Language;
use crate::program::krl::Program;
use crate::program::krl::evaluate::{At, Fault};
use crate::program::krl::syntax::{DataItem, DeclarationKind, Declared, Part, Place};
use crate::program::krl::value::{Type, Value};
use crate::robot::Robot;
use crate::sim::controller::arm::Arm;

impl Interpreter {
    /// A controller of the nominal `robot` with `program` selected, at `override_percent` (1 to 100).
    /// The robot is at KUKA's home, or as near to it as its limits allow.
    pub(in crate::sim::controller) fn new(
        program: Program,
        robot: &Robot,
        override_percent: f64,
    ) -> Result<Self, Diagnostic> {
        let mut controller = Self {
            arm: Arm::at_home(robot, Language::Krl),
            t_s: 0.0,
            dwells: 0,
            centre: 1,
            strobe: None,
            activity: Activity::Ready,
            levels: Vec::new(),
            system: store::system(),
            data: program.modules.iter().map(|_| Names::new()).collect(),
            signals: program.modules.iter().map(|_| BTreeMap::new()).collect(),
            pulses: Vec::new(),
            ekrl: super::ekrl::Channel::default(),
            at: (0, 0..0),
            program,
        };
        let percent = override_percent.clamp(1.0, 100.0).round();
        let set = Variable { kind: Type::Int, value: Value::Int(percent as i64) };
        controller.system.insert("$OV_PRO".into(), set);
        for module in 0..controller.program.modules.len() {
            controller.at = (module, 0..0);
            controller.load(module)?;
        }
        let strobe = |signals: &BTreeMap<String, Signal>| signals.get("DBBSTB").map(|signal| signal.first);
        controller.strobe = controller.signals.iter().find_map(strobe);
        controller.at = (0, 0..0);
        let first = controller.program.modules.first().and_then(|module| module.source.routines.first());
        if let Some(first) = first.cloned() {
            controller.levels.push(Level::routine(0, &first, Names::new()));
            controller.enter(0);
        }
        Ok(controller)
    }

    /// Declares and sets the variables of a module's `.dat`.
    fn load(&mut self, module: usize) -> Result<(), Diagnostic> {
        let Some(data) = self.program.modules.get(module).and_then(|module| module.data.clone()) else {
            return Ok(());
        };
        for item in &data.items {
            let loaded = match item {
                DataItem::Declaration(declaration) => self.declare(module, &declaration.kind),
                DataItem::Value { target, value } => {
                    value.value(self).and_then(|value| self.write(target, value))
                }
            };
            loaded.map_err(|fault| data.as_text().wrong(&fault.span, fault.finding))?;
        }
        Ok(())
    }

    fn declare(&mut self, module: usize, kind: &DeclarationKind) -> Result<(), Fault> {
        match kind {
            DeclarationKind::External { .. } => {}
            DeclarationKind::Signal { name, first, last } => {
                let low = signal_end(first)?;
                let high = last.as_ref().map_or(Ok(low), signal_end)?;
                if high.last < low.first || high.last - low.first > 31 {
                    return Err(Fault::new(&first.span, ProgramFinding::SignalWidth));
                }
                if let Some(signals) = self.signals.get_mut(module) {
                    signals.insert(name.clone(), Signal { last: high.last, ..low });
                }
            }
            DeclarationKind::Variables { type_name, names } => {
                for declared in names {
                    self.declare_variable(module, type_name, declared)?;
                }
            }
        }
        Ok(())
    }

    fn declare_variable(&mut self, module: usize, type_name: &str, declared: &Declared) -> Result<(), Fault> {
        let Some(kind) = Type::named(type_name) else {
            return Err(Fault::new(&declared.span, ProgramFinding::NoType { name: type_name.into() }));
        };
        let mut variable = Variable::new(kind, declared.elements);
        if let Some(value) = &declared.value {
            let given = value.value(self)?;
            variable.value.store(kind, given).at(&value.span)?;
        }
        let Some(variables) = self.data.get_mut(module) else { return Ok(()) };
        match variables.insert(declared.name.clone(), variable) {
            Some(_) => {
                let name = declared.name.clone();
                Err(Fault::new(&declared.span, ProgramFinding::DeclaredTwice { name }))
            }
            None => Ok(()),
        }
    }
}

/// `$OUT[9]`: a signal of this one.
fn signal_end(place: &Place) -> Result<Signal, Fault> {
    let output = place.name == "$OUT";
    let number = match place.parts.as_slice() {
        [Part::Element(index)] if output || place.name == "$IN" => index.index(),
        _ => None,
    };
    let number = number.and_then(|number| usize::try_from(number).ok());
    match number.filter(|number| (1..=4096).contains(number)) {
        Some(number) => Ok(Signal { output, first: number, last: number }),
        None => Err(Fault::new(&place.span, ProgramFinding::NoSignal)),
    }
}

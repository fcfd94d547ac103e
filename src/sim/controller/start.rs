//! A controller with a program selected: its variables declared and set as the `.dat` files say.

use std::collections::BTreeMap;

use super::execute::Level;
use super::store::{self, Names, Variable};
use super::value::{Type, Value};
use super::{Activity, Controller, Fault, Signal};
use crate::diag::Diagnostic;
use crate::krl::Program;
use crate::krl::syntax::{DataItem, DeclarationKind, ExpressionKind, Part, Place};
use crate::model::{AXES, Robot};

/// Where the robot stands before the program: KUKA's home, degrees.
const HOME_DEG: [f64; AXES] = [0.0, -90.0, 90.0, 0.0, 0.0, 0.0];

impl Controller {
    /// A controller of the nominal `robot` with `program` selected, at `override_percent` (1 to 100).
    /// The robot stands at KUKA's home, or as near to it as its limits allow.
    ///
    /// # Errors
    /// A variable that cannot be declared or set, with its line and column.
    pub fn new(program: Program, robot: &Robot, override_percent: f64) -> Result<Self, Diagnostic> {
        let home = |i: usize| {
            let [low, high] = robot.limits_deg[i];
            HOME_DEG[i].clamp(low, high).to_radians()
        };
        let mut controller = Self {
            robot: robot.clone(),
            t_s: 0.0,
            axes: std::array::from_fn(home),
            motions: 0,
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
                    self.evaluate(value).and_then(|value| self.write(target, value))
                }
            };
            loaded.map_err(|fault| Diagnostic::span(&data.file, &data.text, fault.span, fault.message))?;
        }
        Ok(())
    }

    fn declare(&mut self, module: usize, kind: &DeclarationKind) -> Result<(), Fault> {
        match kind {
            DeclarationKind::External { .. } => {}
            DeclarationKind::Signal { name, first, last } => {
                let (output, low) = signal_end(first)?;
                let (_, high) = last.as_ref().map_or(Ok((output, low)), signal_end)?;
                if high < low || high - low > 31 {
                    return Err(Fault::new(&first.span, "a signal has 1 to 32 outputs in a row"));
                }
                if let Some(signals) = self.signals.get_mut(module) {
                    signals.insert(name.clone(), Signal { output, first: low, last: high });
                }
            }
            DeclarationKind::Variables { type_name, names } => {
                for declared in names {
                    let Some(kind) = Type::named(type_name) else {
                        let message = format!("the type {type_name} is not simulated");
                        return Err(Fault::new(&declared.span, message));
                    };
                    let mut variable = Variable::new(kind, declared.elements);
                    if let Some(value) = &declared.value {
                        let given = self.evaluate(value)?;
                        variable.value.store(kind, given).map_err(|why| Fault::new(&value.span, why))?;
                    }
                    let Some(variables) = self.data.get_mut(module) else { continue };
                    if variables.insert(declared.name.clone(), variable).is_some() {
                        return Err(Fault::new(
                            &declared.span,
                            format!("{} is declared twice", declared.name),
                        ));
                    }
                }
            }
        }
        Ok(())
    }
}

/// `$OUT[9]`: whether it is an output, and its number.
fn signal_end(place: &Place) -> Result<(bool, usize), Fault> {
    let wrong = || Fault::new(&place.span, "a signal names $OUT[n] or $IN[n], n from 1 to 4096");
    let output = match place.name.as_str() {
        "$OUT" => true,
        "$IN" => false,
        _ => return Err(wrong()),
    };
    let [Part::Element(index)] = place.parts.as_slice() else { return Err(wrong()) };
    let ExpressionKind::Int(number) = index.kind else { return Err(wrong()) };
    let number =
        usize::try_from(number).ok().filter(|number| (1..=4096).contains(number)).ok_or_else(wrong)?;
    Ok((output, number))
}

//! The functions of EthernetKRL (`EKI_..`) with one channel.
//!
//! The controller itself has no network: the caller takes telegrams from it and passes answers to it (see
//! [`crate::sim::controller::ProgramExecutor`]).

use std::fmt::Write;

use super::{EkrlChannel, Interpreter};
use crate::program::ProgramFinding;
use crate::program::krl::evaluate::{At, Fault};
use crate::program::krl::syntax::{Expression, ExpressionKind, Span};
use crate::program::krl::value::{Type, Value};

/// Numbers of the flags in the configuration of the channel.
const CONNECTED: usize = 1;
const ANSWERED: usize = 2;

impl Interpreter {
    /// Receives the `Id` of an answer.
    pub(super) fn receive_answer(&mut self, id: i64) {
        self.ekrl.answers.push_back(id);
        self.set_bit("$FLAG", ANSWERED, true);
    }

    /// Executes a function; its value is an `EKI_STATUS`.
    pub(super) fn ekrl_call(
        &mut self,
        name: &str,
        arguments: &[Expression],
        span: &Span,
    ) -> Result<Value, Fault> {
        let expected = match name {
            "EKI_INIT" | "EKI_OPEN" | "EKI_CLOSE" | "EKI_CLEAR" => 1,
            "EKI_SEND" => 2,
            "EKI_SETINT" | "EKI_SETREAL" | "EKI_SETBOOL" | "EKI_SETSTRING" | "EKI_GETINT" => 3,
            _ => {
                let instead = "the simulator supports the functions that `dbbd krl` emits".into();
                return Err(Fault::new(span, ProgramFinding::Unsupported { what: name.into(), instead }));
            }
        };
        if arguments.len() != expected {
            let (routine, given) = (name.into(), arguments.len());
            return Err(Fault::new(span, ProgramFinding::Arguments { routine, expected, given }));
        }
        // The first argument is the channel; there is only one.
        let path = match arguments.get(1) {
            Some(path) => path.value(self)?.text().at(&path.span)?.to_owned(),
            None => String::new(),
        };
        if !self.ekrl.is_open && !matches!(name, "EKI_INIT" | "EKI_OPEN" | "EKI_CLEAR") {
            return Err(Fault::new(span, ProgramFinding::ChannelClosed));
        }
        match (name, arguments.get(2)) {
            ("EKI_INIT", _) => self.ekrl.values.clear(),
            ("EKI_OPEN", _) if !self.ekrl.is_linked => {
                return Err(Fault::new(span, ProgramFinding::NoListener));
            }
            ("EKI_OPEN" | "EKI_CLOSE", _) => {
                self.ekrl.is_open = name == "EKI_OPEN";
                self.set_bit("$FLAG", CONNECTED, self.ekrl.is_open);
            }
            ("EKI_SEND", _) => {
                let telegram = self.ekrl.telegram(&path);
                self.ekrl.sent.push_back(telegram);
            }
            ("EKI_GETINT", Some(place)) => self.answer_into(&path, place, span)?,
            (_, Some(value)) => {
                let value = as_text(name, &value.value(self)?).at(&value.span)?;
                self.ekrl.set(path, value);
            }
            _ => self.ekrl.answers.clear(),
        }
        Ok(self.ekrl.status())
    }

    /// `EKI_GetInt`: assigns the next answer to a variable.
    fn answer_into(&mut self, path: &str, place: &Expression, span: &Span) -> Result<(), Fault> {
        let ExpressionKind::Place(place) = &place.kind else {
            let wrong = ProgramFinding::WrongType { expected: "a variable", found: "a value" };
            return Err(Fault::new(&place.span, wrong));
        };
        if path != "Ack/@Id" {
            return Err(Fault::new(span, ProgramFinding::NoSuchAnswer { path: path.into() }));
        }
        let Some(id) = self.ekrl.answers.pop_front() else {
            return Err(Fault::new(span, ProgramFinding::NoAnswer));
        };
        self.write(place, Value::Int(id))
    }
}

/// A value as `EKI_Set..` writes it into a telegram.
fn as_text(function: &str, value: &Value) -> Result<String, ProgramFinding> {
    Ok(match function {
        "EKI_SETINT" => value.int()?.to_string(),
        "EKI_SETREAL" => format!("{:.6}", value.number()?),
        "EKI_SETBOOL" => u8::from(value.bool()?).to_string(),
        _ => value.text()?.to_owned(),
    })
}

impl EkrlChannel {
    fn set(&mut self, path: String, value: String) {
        match self.values.iter_mut().find(|(known, _)| *known == path) {
            Some((_, old)) => *old = value,
            None => self.values.push((path, value)),
        }
    }

    /// The value of every function.
    fn status(&self) -> Value {
        let mut status = Type::named("EKI_STATUS").map_or(Value::Unset, Type::unset);
        if let Value::Struct(fields) = &mut status {
            let buffered = i64::try_from(self.answers.len()).unwrap_or(i64::MAX);
            fields.insert("BUFF".into(), Value::Int(buffered));
            fields.insert("CONNECTED".into(), Value::Bool(self.is_open));
            fields.insert("MSG_NO".into(), Value::Int(0));
        }
        status
    }

    /// `<Root><Element Name="value"></Element></Root>` with the values whose path begins with `root`.
    fn telegram(&self, root: &str) -> String {
        let mut elements: Vec<(&str, String)> = Vec::new();
        for (path, value) in &self.values {
            let parts = path.strip_prefix(root).and_then(|rest| rest.strip_prefix('/')?.split_once("/@"));
            let Some((element, attribute)) = parts else { continue };
            if elements.last().is_none_or(|(last, _)| *last != element) {
                elements.push((element, String::new()));
            }
            if let Some((_, attributes)) = elements.last_mut() {
                let _ = write!(attributes, " {attribute}=\"{value}\"");
            }
        }
        let inside: String =
            elements.iter().map(|(name, given)| format!("<{name}{given}></{name}>")).collect();
        format!("<{root}>{inside}</{root}>")
    }
}

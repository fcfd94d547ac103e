//! The EthernetKRL functions of a program: one channel, values set by path, telegrams, answers.
//!
//! The controller itself reaches no network: telegrams wait in [`Controller::telegram`] for whoever
//! carries them, and answers come back through [`Controller::answer`].

use std::collections::VecDeque;
use std::fmt::Write;

use super::value::{Type, Value};
use super::{Controller, Fault};
use crate::krl::syntax::{Expression, ExpressionKind, Span};

/// Flags of the channel's file: connected, answered.
const CONNECTED: usize = 1;
const ANSWERED: usize = 2;

/// The channel.
#[derive(Clone, Debug, Default)]
pub(super) struct Channel {
    /// Whether somebody carries the telegrams.
    linked: bool,
    open: bool,
    /// Values by path, in the order in which they were first set.
    values: Vec<(String, String)>,
    sent: VecDeque<String>,
    answers: VecDeque<i64>,
}

impl Controller {
    /// Says that telegrams are carried to a server: without that a channel cannot be opened.
    pub fn link_ekrl(&mut self) {
        self.ekrl.linked = true;
    }

    /// Whether the program holds the channel open.
    pub fn ekrl_open(&self) -> bool {
        self.ekrl.open
    }

    /// The next telegram to be sent.
    pub fn telegram(&mut self) -> Option<String> {
        self.ekrl.sent.pop_front()
    }

    /// The `Id` of an answer that has come.
    pub fn answer(&mut self, id: i64) {
        self.ekrl.answers.push_back(id);
        self.set_flag(ANSWERED, true);
    }

    fn set_flag(&mut self, flag: usize, level: bool) {
        if let Some(Value::Array(flags)) = self.system.get_mut("$FLAG").map(|variable| &mut variable.value)
            && let Some(here) = flag.checked_sub(1).and_then(|at| flags.get_mut(at))
        {
            *here = Value::Bool(level);
        }
    }

    /// An `EKI_..` function; its value is the status that KUKA's give.
    pub(super) fn ekrl_call(
        &mut self,
        name: &str,
        arguments: &[Expression],
        span: &Span,
    ) -> Result<Value, Fault> {
        let text = |controller: &mut Self, at: usize| match arguments.get(at) {
            Some(argument) => match controller.evaluate(argument)? {
                Value::Text(text) => Ok(text),
                _ => Err(Fault::new(&argument.span, "expected a text")),
            },
            None => Err(Fault::new(span, format!("{name} takes more arguments"))),
        };
        let third =
            || arguments.get(2).ok_or_else(|| Fault::new(span, format!("{name} takes three arguments")));
        text(self, 0)?; // the channel: there is one
        if !self.ekrl.open && !matches!(name, "EKI_INIT" | "EKI_OPEN" | "EKI_CLEAR") {
            return Err(Fault::new(span, "the channel is not open").help("EKI_Open comes first"));
        }
        match name {
            "EKI_INIT" => self.ekrl.values.clear(),
            "EKI_OPEN" if !self.ekrl.linked => {
                return Err(Fault::new(span, "nothing listens to the channel")
                    .help("give the server's address: simulate --ekrl ADDR:PORT"));
            }
            "EKI_OPEN" | "EKI_CLOSE" => {
                self.ekrl.open = name == "EKI_OPEN";
                self.set_flag(CONNECTED, self.ekrl.open);
            }
            "EKI_CLEAR" => self.ekrl.answers.clear(),
            "EKI_SETINT" | "EKI_SETREAL" | "EKI_SETBOOL" | "EKI_SETSTRING" => {
                let path = text(self, 1)?;
                let value = self.evaluate(third()?)?;
                let wrong = |why| Fault::new(span, why);
                let value = match name {
                    "EKI_SETINT" => value.int().map_err(wrong)?.to_string(),
                    "EKI_SETREAL" => format!("{:.6}", value.number().map_err(wrong)?),
                    "EKI_SETBOOL" => u8::from(value.bool().map_err(wrong)?).to_string(),
                    _ => text(self, 2)?,
                };
                match self.ekrl.values.iter_mut().find(|(known, _)| *known == path) {
                    Some((_, old)) => *old = value,
                    None => self.ekrl.values.push((path, value)),
                }
            }
            "EKI_SEND" => {
                let root = text(self, 1)?;
                let telegram = self.ekrl.telegram(&root);
                self.ekrl.sent.push_back(telegram);
            }
            "EKI_GETINT" => {
                let path = text(self, 1)?;
                let place = third()?;
                let ExpressionKind::Place(place) = &place.kind else {
                    return Err(Fault::new(&place.span, "expected a variable"));
                };
                if path != "Ack/@Id" {
                    return Err(Fault::new(span, format!("the answer has no {path}")));
                }
                let Some(id) = self.ekrl.answers.pop_front() else {
                    return Err(Fault::new(span, "no answer has come").help("wait for its flag first"));
                };
                self.write(place, Value::Int(id))?;
            }
            _ => return Err(Fault::new(span, format!("{name} is not simulated"))),
        }
        let status = Type::named("EKI_STATUS").map_or(Value::Unset, Type::unset);
        Ok(match status {
            Value::Struct(mut fields) => {
                let buffered = i64::try_from(self.ekrl.answers.len()).unwrap_or(i64::MAX);
                fields.insert("BUFF".into(), Value::Int(buffered));
                fields.insert("CONNECTED".into(), Value::Bool(self.ekrl.open));
                fields.insert("MSG_NO".into(), Value::Int(0));
                Value::Struct(fields)
            }
            other => other,
        })
    }
}

impl Channel {
    /// `<Root><Element Name="value"></Element></Root>` of the values under a root.
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

//! The values of the variables at a statement.

use std::collections::BTreeMap;
use std::rc::Rc;

use super::value::Value;

/// Variables by name. A variable with another value on another way is kept without a value.
#[derive(Clone, Debug, Default)]
pub(crate) struct Scope(Rc<BTreeMap<Rc<str>, Option<Rc<Value>>>>);

impl PartialEq for Scope {
    fn eq(&self, other: &Self) -> bool {
        Rc::ptr_eq(&self.0, &other.0) || self.0 == other.0
    }
}

impl Scope {
    /// The value of a variable; `Some(None)` if the value is not known.
    pub(crate) fn get(&self, name: &str) -> Option<Option<&Value>> {
        self.0.get(name).map(Option::as_deref)
    }

    /// Sets a variable; `None` for a value that is not known.
    pub(crate) fn set(&mut self, name: &str, value: Option<Value>) {
        Rc::make_mut(&mut self.0).insert(name.into(), value.map(Rc::new));
    }

    /// Makes all variables unknown.
    pub(crate) fn forget(&mut self) {
        if self.0.values().any(Option::is_some) {
            Rc::make_mut(&mut self.0).values_mut().for_each(|value| *value = None);
        }
    }

    /// Keeps the values that are the same on another way.
    pub(crate) fn join(&mut self, other: &Self) {
        if *self == *other {
            return;
        }
        let variables = Rc::make_mut(&mut self.0);
        for (name, value) in variables.iter_mut() {
            if other.0.get(name) != Some(value) {
                *value = None;
            }
        }
        for name in other.0.keys() {
            variables.entry(Rc::clone(name)).or_insert(None);
        }
    }

    /// The variables after a call. `self` are the variables before the call, `end` those at the end of the routine. A
    /// variable for which `is_shared` holds takes its value from the end, a variable of the routine itself (`is_own`)
    /// from before the call; other variables are known only if both values agree.
    pub(crate) fn after_call(
        mut self,
        end: &Self,
        is_shared: impl Fn(&str) -> bool,
        is_own: impl Fn(&str) -> bool,
    ) -> Self {
        if self == *end {
            return self;
        }
        let before = Rc::make_mut(&mut self.0);
        for (name, value) in end.0.iter() {
            if is_own(name) {
                continue;
            }
            if is_shared(name) {
                before.insert(Rc::clone(name), value.clone());
            } else if let Some(known) = before.get_mut(name)
                && known != value
            {
                *known = None;
            }
        }
        self
    }
}

//! Code that the tests of this crate share. The crates above and the suite include these files, so that there is one of
//! each.

pub(crate) mod cell;
pub(crate) mod checked_robot;
pub(crate) mod circular_cases;

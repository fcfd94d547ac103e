//! One integration binary: each module holds one promise, driven through what a user touches.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stderr)]
mod inverse_kinematics;

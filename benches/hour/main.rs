//! An hour at 1 kHz, 3.6 million samples, through the program itself: what each verb takes as a process of its own.
//!
//! `cargo bench --bench hour` (340 MB in the temporary directory). Peak memory is `VmHWM` of Linux; elsewhere it shows as 0.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stderr)]

mod verbs;

fn main() {
    // `cargo test --all-targets` runs benches as well, without this.
    if std::env::args().any(|argument| argument == "--bench") {
        verbs::run(verbs::HOUR, 5);
    }
}

//! What a set of poses can tell: rank, base parameters, dependent directions in words, and the
//! 3-D position error that is left.

mod alignment;
mod analysis;
mod belief;
mod exchange;
mod observability;
mod outlook;
mod predicted;
mod wording;

pub use alignment::aligned_distances;
pub use analysis::{Analysis, Combination, analyse, factor};
pub use belief::Belief;
pub use exchange::{Criterion, Exchange};
pub use observability::{Observability, observability};
pub use outlook::{Foreseen, Outlook, outlook};
pub use predicted::{ErrorSummary, Estimator, Workspace};

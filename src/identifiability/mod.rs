//! What a set of poses can tell: rank, base parameters, dependent directions in words, and the
//! 3-D position error that is left.

mod alignment;
mod analysis;
mod belief;
mod correlation;
mod exchange;
mod observability;
mod outlook;
mod predicted;
pub mod trial;
mod wording;

pub use alignment::aligned_distances;
pub use analysis::{Analysis, Combination, analyse, factor};
pub use belief::{Belief, known_beforehand};
pub use correlation::{Correlation, correlations};
pub use exchange::{Criterion, Exchange};
pub use observability::{Observability, observability};
pub use outlook::{Foreseen, Outlook, outlook};
pub use predicted::{ErrorSummary, Estimator, Workspace};

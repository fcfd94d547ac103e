//! Rows of a plan or a table by their index.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Indices in the order in which they are given.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct RowIndices(Vec<u32>);

impl RowIndices {
    pub fn iter(&self) -> impl Iterator<Item = u32> {
        self.0.iter().copied()
    }

    pub fn contains(&self, index: u32) -> bool {
        self.0.contains(&index)
    }
}

impl FromStr for RowIndices {
    type Err = String;

    /// Reads indices and ranges, as `3,7-9`.
    fn from_str(text: &str) -> Result<Self, String> {
        /// Longest range: a longer one is a typing error.
        const MAX_RANGE: u32 = 100_000;
        let mut indices = Vec::new();
        for item in text.split(',') {
            let (first, last) = item.split_once('-').unwrap_or((item, item));
            let number = |text: &str| text.trim().parse::<u32>();
            match (number(first), number(last)) {
                (Ok(first), Ok(last)) if first <= last && last - first < MAX_RANGE => {
                    indices.extend(first..=last)
                }
                _ => return Err(format!("`{item}` is neither an index nor a range as 7-9")),
            }
        }
        Ok(Self(indices))
    }
}

impl fmt::Display for RowIndices {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.0.iter().map(u32::to_string).collect::<Vec<_>>().join(","))
    }
}

impl FromIterator<u32> for RowIndices {
    fn from_iter<T: IntoIterator<Item = u32>>(indices: T) -> Self {
        Self(indices.into_iter().collect())
    }
}

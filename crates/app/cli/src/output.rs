//! Standard output that its reader may close, as `| head` does.

use std::io::{ErrorKind, Result, Write};

use crate::CommandError;

/// Passes on the output. After the reader has closed it, the rest is dropped: this is not an error of the
/// command, which continues to its end and has its own exit code.
#[derive(Debug)]
pub(crate) struct Output<W> {
    inner: W,
    is_closed: bool,
}

impl<W: Write> Output<W> {
    pub(crate) fn new(inner: W) -> Self {
        Self {
            inner,
            is_closed: false,
        }
    }

    fn pass<T>(&mut self, dropped: T, write: impl FnOnce(&mut W) -> Result<T>) -> Result<T> {
        if self.is_closed {
            return Ok(dropped);
        }
        match write(&mut self.inner) {
            Err(error) if error.kind() == ErrorKind::BrokenPipe => {
                self.is_closed = true;
                Ok(dropped)
            }
            result => result,
        }
    }
}

/// The error of a report that could not be written.
pub(crate) fn written(result: Result<()>) -> core::result::Result<(), CommandError> {
    result.map_err(|error| CommandError::Failed(format!("the report cannot be written: {error}")))
}

impl<W: Write> Write for Output<W> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        self.pass(bytes.len(), |inner| inner.write(bytes))
    }

    fn flush(&mut self) -> Result<()> {
        self.pass((), Write::flush)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Accepts this many bytes.
    struct Head(usize, ErrorKind);

    impl Write for Head {
        fn write(&mut self, bytes: &[u8]) -> Result<usize> {
            if self.0 < bytes.len() {
                return Err(self.1.into());
            }
            self.0 -= bytes.len();
            Ok(bytes.len())
        }

        fn flush(&mut self) -> Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_broken_pipe_is_no_error_but_a_full_disk_is() {
        let mut output = Output::new(Head(4, ErrorKind::BrokenPipe));
        for _ in 0..3 {
            assert!(writeln!(output, "abc").is_ok());
        }
        assert!(output.is_closed && output.flush().is_ok());
        let mut output = Output::new(Head(4, ErrorKind::StorageFull));
        assert!(writeln!(output, "abc").is_ok());
        assert!(writeln!(output, "abc").is_err());
    }
}

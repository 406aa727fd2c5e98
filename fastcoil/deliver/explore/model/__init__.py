"""What the page shows, without a page: settings in, numbers and sentences out."""

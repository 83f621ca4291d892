"""10.2, 10.3, appendices A-C: what the laboratory files, as PDF and DOCX, Chinese or English."""

-- Restrict the statements on a connection to the files of its views.
-- Statements can read no other files and no Python objects. They can load no extensions, and change no settings.
SET enable_progress_bar = false;
SET python_enable_replacements = false;
SET autoinstall_known_extensions = false;
SET autoload_known_extensions = false;
SET temp_directory = '';
SET memory_limit = '2GB';
SET enable_external_access = false;
SET lock_configuration = true;
